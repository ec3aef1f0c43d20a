/* An emulating libnvrtc.so: the source that it is given is compiled by the system's C++ compiler ($CXX or c++), with shim.h before
 * it. What it makes is a shared object for the emulating driver, with its size in front.
 *
 *   EMULATOR_CHECK=1         each access is checked by the driver (check.cc), undefined behaviour traps; gcc alone
 *   EMULATOR_COVERAGE=DIR    lines are counted: DIR gets a folder for each compilation, for gcov
 *   EMULATOR_FLAGS="..."     of the compiler, instead of -O1 */
#include <limits.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>
#include <string>
#include <vector>

namespace
{
struct program {
    std::string source, name, log, image;
    std::vector<std::string> header, header_name;
};

std::string read_file(const std::string &path)
{
    std::string all;
    if (FILE *file = fopen(path.c_str(), "rb")) {
        char part[65536];
        for (size_t n; (n = fread(part, 1, sizeof part, file)) > 0;) all.append(part, n);
        fclose(file);
    }
    return all;
}

bool write_file(const std::string &path, const std::string &text)
{
    for (size_t at = 1; (at = path.find('/', at)) != std::string::npos; at++) mkdir(path.substr(0, at).c_str(), 0700);
    FILE *file = fopen(path.c_str(), "wb");
    if (!file) return false;
    const bool good = fwrite(text.data(), 1, text.size(), file) == text.size();
    return fclose(file) == 0 && good;
}

std::string variable(const char *name, const char *otherwise)
{
    const char *text = getenv(name);
    return text && *text ? text : otherwise;
}
bool setting(const char *name) { return variable(name, "0") != "0"; }

std::string compiler() { return variable("CXX", "c++"); }
std::string coverage() { return variable("EMULATOR_COVERAGE", ""); }

std::string flags()
{
    std::string all = "-x c++ -w -fPIC -fvisibility=hidden -ffp-contract=off -fno-exceptions ";
    if (compiler().find("clang") == std::string::npos) all += "-fno-gnu-unique "; /* or the module would never be unloaded */
    all += coverage().empty() ? variable("EMULATOR_FLAGS", "-O1") : "-O0 --coverage -fprofile-update=single";
    if (setting("EMULATOR_CHECK"))
        all += " -g1 -DEMULATOR_CHECKED -fsanitize=thread -fsanitize=undefined -fno-sanitize=vptr,object-size -fsanitize-undefined-trap-on-error";
    return all;
}

uint64_t hash(const std::string &text, uint64_t from)
{
    for (const char c : text) from = (from ^ (unsigned char)c) * 0x100000001b3ull;
    return from;
}

std::string quoted(const std::string &text)
{
    std::string all = "'";
    for (const char c : text) all += c == '\'' ? "'\\''" : std::string(1, c);
    return all + "'";
}

/* The folder goes from what is said: tensor/x.kernel.h:12: error: ... */
std::string without(std::string text, const std::string &folder)
{
    for (size_t at; (at = text.find(folder)) != std::string::npos;) text.erase(at, folder.size());
    return text;
}

bool make_folder(std::string &at)
{
    at = coverage().empty() ? variable("TMPDIR", "/tmp") : coverage();
    if (!coverage().empty()) mkdir(at.c_str(), 0755);
    at += "/emulated-nvrtc-XXXXXX";
    if (!mkdtemp(&at[0])) return false;
    char real[PATH_MAX];
    if (realpath(at.c_str(), real)) at = real;
    return true;
}
} // namespace

extern "C" {
typedef program *nvrtcProgram;

/* The version is a hash of all that an image depends on, so that one of another emulator is not taken from a cache. */
int nvrtcVersion(int *major, int *minor)
{
    uint64_t all = hash(read_file(EMULATOR_SOURCE "/shim.h"), 0xcbf29ce484222325ull);
    all = hash(read_file(EMULATOR_SOURCE "/table.h") + read_file(EMULATOR_SOURCE "/libnvrtc.cc"), all);
    all = hash(compiler() + " " + flags() + " " + coverage(), all);
    *major = 13;
    *minor = (int)(all % 1000000);
    return 0;
}
const char *nvrtcGetErrorString(int result)
{
    static const char *const names[] = { "NVRTC_SUCCESS", "NVRTC_ERROR_OUT_OF_MEMORY", "NVRTC_ERROR_PROGRAM_CREATION_FAILURE", "NVRTC_ERROR_INVALID_INPUT",
                                         "NVRTC_ERROR_INVALID_PROGRAM", "NVRTC_ERROR_INVALID_OPTION", "NVRTC_ERROR_COMPILATION" };
    return result >= 0 && result <= 6 ? names[result] : "NVRTC_ERROR unknown";
}
int nvrtcGetNumSupportedArchs(int *n) { return *n = 3, 0; }
int nvrtcGetSupportedArchs(int *archs) { return archs[0] = 80, archs[1] = 90, archs[2] = 120, 0; }

int nvrtcCreateProgram(nvrtcProgram *out, const char *source, const char *name, int n, const char *const *headers, const char *const *names)
{
    if (!source || !out || n < 0) return 3;
    program *p = new program;
    p->source = source;
    p->name = name ? name : "default_program";
    for (int i = 0; i < n; i++) {
        p->header.push_back(headers[i]);
        p->header_name.push_back(names[i]);
    }
    *out = p;
    return 0;
}

int nvrtcDestroyProgram(nvrtcProgram *p)
{
    if (!p || !*p) return 4;
    delete *p;
    *p = nullptr;
    return 0;
}

int nvrtcCompileProgram(nvrtcProgram p, int n_options, const char *const *options)
{
    std::string at, own;
    for (int i = 0; i < n_options; i++) {
        const std::string option = options[i];
        if (option.compare(0, 2, "-D") == 0 || option.compare(0, 6, "--std=") == 0 || option.compare(0, 5, "-std=") == 0) own += " " + quoted(option);
        else if (option.compare(0, 19, "--gpu-architecture=") != 0 && option.compare(0, 7, "--fmad=") != 0 && option != "-default-device" && option != "--generate-line-info" &&
                 option.compare(0, 7, "-arch=") != 0 && option != "-lineinfo" && option != "--Werror" && option.compare(0, 6, "--diag") != 0) {
            p->log = "nvrtc: error: the emulated NVRTC does not know the option " + option + "\n";
            return 5;
        }
    }
    if (!make_folder(at)) return p->log = "nvrtc: error: no temporary folder\n", 1;
    for (size_t i = 0; i < p->header.size(); i++) /* <math.h> and the like are the system's */
        if (p->header_name[i].find('/') != std::string::npos && !write_file(at + "/" + p->header_name[i], p->header[i])) return p->log = "nvrtc: error: no room for headers\n", 1;
    write_file(at + "/source.cu", "#include \"shim.h\"\n#line 1 \"" + p->name + "\"\n" + p->source);
    const std::string folder = quoted(at + "/"), common = compiler() + " " + flags() + own + " -fmacro-prefix-map=" + folder + "= -fdebug-prefix-map=" + folder + "= -I" + quoted(at) +
                               " -I" + quoted(EMULATOR_SOURCE);
    /* In two steps: linked with -fsanitize the sanitizer's own library would come along. */
    const std::string command = "cd " + quoted(at) + " && { " + common + " -c " + folder + "source.cu -o " + folder + "image.o && " + compiler() + " -shared " +
                                (coverage().empty() ? "" : "--coverage ") + folder + "image.o -o " + folder + "image.so -lm; } > " + folder + "log 2>&1";
    const int status = system(command.c_str());
    p->log = without(read_file(at + "/log"), at + "/");
    p->image.clear();
    if (status == 0) {
        const std::string image = read_file(at + "/image.so");
        const uint64_t size = image.size();
        p->image = "EMULATED" + std::string((const char *)&size, sizeof size) + image;
    } else if (p->log.empty()) {
        p->log = "nvrtc: error: " + compiler() + " could not be run\n";
    }
    if (coverage().empty() && !setting("EMULATOR_KEEP")) {
        if (system(("rm -rf " + quoted(at)).c_str()) != 0) p->log += "nvrtc: warning: " + at + " was left behind\n";
    }
    return status == 0 ? 0 : 6;
}

int nvrtcGetProgramLogSize(nvrtcProgram p, size_t *size) { return *size = p->log.size() + 1, 0; }
int nvrtcGetProgramLog(nvrtcProgram p, char *log) { return memcpy(log, p->log.c_str(), p->log.size() + 1), 0; }
int nvrtcGetPTXSize(nvrtcProgram p, size_t *size) { return p->image.empty() ? 4 : (*size = p->image.size(), 0); }
int nvrtcGetPTX(nvrtcProgram p, char *to) { return memcpy(to, p->image.data(), p->image.size()), 0; }
int nvrtcGetCUBINSize(nvrtcProgram p, size_t *size) { return nvrtcGetPTXSize(p, size); }
int nvrtcGetCUBIN(nvrtcProgram p, char *to) { return nvrtcGetPTX(p, to); }
}
