/* An emulating libnvrtc.so: the source that it is given is compiled by the system's C++ compiler, with shim.h before it. Its
 * "PTX" is a shared object for the emulating driver, with its size in front. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
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
} // namespace

extern "C" {
typedef program *nvrtcProgram;

int nvrtcVersion(int *major, int *minor) { return *major = 0, *minor = EMULATOR_VERSION, 0; }
const char *nvrtcGetErrorString(int result) { return result == 0 ? "NVRTC_SUCCESS" : result == 6 ? "NVRTC_ERROR_COMPILATION" : "NVRTC_ERROR"; }
int nvrtcGetNumSupportedArchs(int *n) { return *n = 3, 0; }
int nvrtcGetSupportedArchs(int *archs) { return archs[0] = 80, archs[1] = 90, archs[2] = 120, 0; }

int nvrtcCreateProgram(nvrtcProgram *out, const char *source, const char *name, int n, const char *const *headers, const char *const *names)
{
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
    delete *p;
    *p = nullptr;
    return 0;
}

int nvrtcCompileProgram(nvrtcProgram p, int n_options, const char *const *options)
{
    char folder[] = "/tmp/emulated-nvrtc-XXXXXX";
    if (!mkdtemp(folder)) return 1;
    const std::string at = folder;
    std::string flags;
    for (int i = 0; i < n_options; i++)
        if (strncmp(options[i], "-D", 2) == 0 || strncmp(options[i], "--std", 5) == 0) flags += std::string(" '") + options[i] + "'";
    for (size_t i = 0; i < p->header.size(); i++)
        if (p->header_name[i].find('/') != std::string::npos) write_file(at + "/" + p->header_name[i], p->header[i]);
    write_file(at + "/source.cu", "#include \"shim.h\"\nemulator_state *emulator;\nemulator_kernel *emulator_kernels;\n#line 1 \"" + p->name + "\"\n" + p->source);
    const char *compiler = getenv("CXX_EMULATOR") ? getenv("CXX_EMULATOR") : "c++";
    const char *more = getenv("EMULATOR_FLAGS") ? getenv("EMULATOR_FLAGS") : "-O1";
    const std::string command = std::string(compiler) + " -x c++ -w -fPIC -shared -ffp-contract=off " + more + flags + " -I'" + at + "' -I'" EMULATOR_SOURCE "' '" + at +
                                "/source.cu' -o '" + at + "/image.so' > '" + at + "/log' 2>&1";
    const int failed = system(command.c_str());
    p->log = read_file(at + "/log");
    if (!failed) {
        const std::string image = read_file(at + "/image.so");
        const unsigned long size = image.size();
        p->image = "EMULATED" + std::string((const char *)&size, sizeof size) + image;
    }
    if (!getenv("EMULATOR_KEEP")) system(("rm -rf '" + at + "'").c_str());
    return failed ? 6 : 0;
}

int nvrtcGetProgramLogSize(nvrtcProgram p, size_t *size) { return *size = p->log.size() + 1, 0; }
int nvrtcGetProgramLog(nvrtcProgram p, char *log) { return memcpy(log, p->log.c_str(), p->log.size() + 1), 0; }
int nvrtcGetPTXSize(nvrtcProgram p, size_t *size) { return *size = p->image.size(), 0; }
int nvrtcGetPTX(nvrtcProgram p, char *to) { return memcpy(to, p->image.data(), p->image.size()), 0; }
int nvrtcGetCUBINSize(nvrtcProgram p, size_t *size) { return *size = p->image.size(), 0; }
int nvrtcGetCUBIN(nvrtcProgram p, char *to) { return memcpy(to, p->image.data(), p->image.size()), 0; }
}
