/* PTX to C++: one function for each .entry and .func; registers become locals, labels stay labels, shared memory is one window
 * with addresses of its own (PTX keeps them in 32 bits). What is not known is refused by name, at translation. */
#include "ptx.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#include <fstream>
#include <functional>
#include <map>
#include <sstream>
#include <vector>

namespace
{
typedef std::vector<std::string> words;

struct failure {
    std::string what;
};
[[noreturn]] void refuse(const std::string &what) { throw failure{ what }; }

/* ---- words ---- */

bool is_word(char c) { return isalnum((unsigned char)c) || c == '_' || c == '$' || c == '%' || c == '.' || c == ':'; }

/* Numbers, names (with their dots), and single characters; comments and lines of .loc, .file, .version and the like are gone. */
words split(const std::string &ptx)
{
    words all;
    for (size_t i = 0; i < ptx.size();) {
        const char c = ptx[i];
        if (isspace((unsigned char)c) || c == '\0') {
            i++;
        } else if (ptx.compare(i, 2, "//") == 0) {
            i = ptx.find('\n', i);
            if (i == std::string::npos) break;
        } else if (ptx.compare(i, 2, "/*") == 0) {
            i = ptx.find("*/", i) + 2;
        } else if (c == '"') {
            const size_t end = ptx.find('"', i + 1);
            all.push_back(ptx.substr(i, end + 1 - i));
            i = end + 1;
        } else if (is_word(c)) {
            size_t end = i;
            while (end < ptx.size() && is_word(ptx[end])) end++;
            std::string word = ptx.substr(i, end - i);
            if (word.size() > 1 && word.back() == ':') { /* a label; "L1::cache" has its colons inside */
                all.push_back(word.substr(0, word.size() - 1));
                all.push_back(":");
            } else if (word == ".version" || word == ".target" || word == ".address_size" || word == ".file" || word == ".loc") {
                end = ptx.find('\n', i);
            } else {
                all.push_back(word);
            }
            i = end;
        } else {
            all.push_back(std::string(1, c));
            i++;
        }
    }
    return all;
}

words parts_of(const std::string &word) /* "ld.global.f32" */
{
    words parts;
    size_t at = 0;
    for (;;) {
        const size_t dot = word.find('.', at);
        if (dot != at) parts.push_back(word.substr(at, dot == std::string::npos ? dot : dot - at));
        if (dot == std::string::npos) return parts;
        at = dot + 1;
    }
}

bool has(const words &parts, const char *what)
{
    for (const std::string &part : parts)
        if (part == what) return true;
    return false;
}

std::string name_of(const std::string &word) /* a C++ name */
{
    std::string name;
    for (char c : word) name += c == '%' ? 'v' : c == '$' ? 'L' : c == '.' ? '_' : c;
    return "p_" + name;
}

size_t bytes_of(const std::string &type)
{
    const int bits = atoi(type.c_str() + 1);
    if (bits != 8 && bits != 16 && bits != 32 && bits != 64) refuse("type ." + type);
    return (size_t)bits / 8;
}

std::string text_of(size_t n) { return std::to_string(n); }

/* ---- one translation ---- */

class translator
{
  public:
    explicit translator(const std::string &ptx) : in(split(ptx)) {}

    std::string run()
    {
        while (at < in.size()) {
            const std::string word = take();
            if (word == ".visible" || word == ".weak" || word == ".extern" || word == ";") continue;
            if (word == ".entry" || word == ".func") function(word == ".entry");
            else if (word == ".global" || word == ".const" || word == ".shared") variable(word);
            else refuse("directive " + word);
        }
        return "#include \"ptx_runtime.h\"\nenum { SHARED = " + text_of(shared + 16) +
               " };\n__shared__ __attribute__((aligned(16))) unsigned char shared_memory[SHARED];\nstatic inline u64 shared_at(u64 address) { return (u32)address < SHARED ? "
               "(u64)(uintptr_t)(shared_memory + (u32)address) : (u64)(uintptr_t)emulator->dynamic_shared + (u32)address - SHARED; }\n"
               "static inline u64 shared_address(u64 generic) { const u64 first = (u64)(uintptr_t)shared_memory; return generic >= first && generic < first + SHARED ? "
               "generic - first : generic - (u64)(uintptr_t)emulator->dynamic_shared + SHARED; }\n" + declarations + bodies;
    }

  private:
    words in;
    size_t at = 0, shared = 0;
    std::string declarations, bodies, out, kernel, parameter_sizes;
    std::map<std::string, char> symbols;        /* g: global, s: shared, d: dynamic shared, p: parameter, l: local */
    std::map<std::string, size_t> shared_place; /* of a static shared variable */
    std::map<std::string, words> tables;        /* of branch targets */

    const std::string &peek() const
    {
        if (at >= in.size()) refuse("the end of the text");
        return in[at];
    }
    std::string take()
    {
        const std::string word = peek();
        at++;
        return word;
    }
    void expect(const char *what)
    {
        const std::string word = take();
        if (word != what) refuse("\"" + word + "\" where \"" + what + "\" was expected");
    }

    /* [.align N] .type NAME [SIZE]: bytes. */
    std::string described(size_t *bytes, std::string *align, std::string *type)
    {
        *align = "8";
        for (;;) {
            const std::string word = take();
            if (word == ".align") *align = take();
            else if (word == ".ptr" || word == ".global" || word == ".noalias") continue;
            else if (word[0] == '.') *type = word.substr(1);
            else {
                *bytes = bytes_of(*type);
                if (at < in.size() && peek() == "[") {
                    take();
                    *bytes = peek() == "]" ? 0 : *bytes * strtoull(take().c_str(), nullptr, 0);
                    expect("]");
                }
                return word;
            }
        }
    }

    void variable(const std::string &space)
    {
        size_t bytes;
        std::string align, type;
        const std::string name = described(&bytes, &align, &type);
        if (space == ".shared") {
            symbols[name] = bytes ? 's' : 'd';
            const size_t alignment = strtoull(align.c_str(), nullptr, 0);
            shared = (shared + alignment - 1) / alignment * alignment;
            shared_place[name] = shared;
            shared += bytes;
        } else {
            symbols[name] = 'g';
            declarations += "alignas(" + align + ") static u8 " + name_of(name) + "[" + text_of(bytes) + "]";
            if (peek() == "=") {
                take();
                expect("{");
                if (type != "b8" && type != "u8") refuse("an initialised array of ." + type);
                declarations += " = {";
                while (peek() != "}") declarations += take();
                take();
                declarations += "}";
            }
            declarations += ";\n";
        }
        expect(";");
    }

    /* ( .param .type NAME, ... ): pointers to the values, in order. */
    words parameters()
    {
        words names;
        parameter_sizes.clear();
        expect("(");
        while (peek() != ")") {
            if (peek() == ",") take();
            expect(".param");
            size_t bytes;
            std::string align, type;
            names.push_back(described(&bytes, &align, &type));
            symbols[names.back()] = 'p';
            parameter_sizes += text_of(bytes) + ", ";
        }
        take();
        return names;
    }

    void function(bool entry)
    {
        words results, given;
        if (!entry && peek() == "(") results = parameters();
        kernel = take();
        if (peek() == "(") given = parameters();
        const std::string sizes = parameter_sizes;
        while (peek() != "{" && peek() != ";") take(); /* .maxntid 256, 1, 1 and the like */
        const std::string head = "static void " + name_of(kernel) + (entry ? "(void **given)" : "(void *result, void **given)");
        declarations += head + ";\n";
        if (take() == ";") return;
        out.clear();
        out += head + "\n{\n";
        for (size_t i = 0; i < given.size(); i++) out += "    u8 *const " + name_of(given[i]) + " = (u8 *)given[" + text_of(i) + "];\n";
        if (!results.empty()) out += "    u8 *const " + name_of(results[0]) + " = (u8 *)result;\n";
        for (int depth = 1; depth > 0;) {
            const std::string word = take();
            if (word == "{") out += "{\n", depth++;
            else if (word == "}") out += "}\n", depth--;
            else if (at < in.size() && peek() == ":") label(word);
            else statement(word);
        }
        bodies += out;
        if (entry)
            bodies += "static const size_t sizes_" + kernel + "[] = { " + sizes + "0 };\nstatic emulator_kernel export_" + kernel + " = { \"" + kernel + "\", " + name_of(kernel) + ", sizes_" + kernel +
                      ", nullptr };\n__attribute__((constructor)) static void add_" + kernel + "() { export_" + kernel +
                      ".next = emulator_this_module.kernels; emulator_this_module.kernels = &export_" + kernel + "; }\n";
    }

    void label(const std::string &word)
    {
        take();
        if (peek() == ".branchtargets") {
            take();
            words &targets = tables[word];
            while (peek() != ";")
                if (peek() == ",") take();
                else targets.push_back(take());
            take();
        } else {
            out += name_of(word) + ":;\n";
        }
    }

    /* ---- operands ---- */

    struct operand {
        std::string word;         /* a register, number, symbol */
        std::string second;       /* of d|p */
        words vector;             /* {a, b} */
        std::string base, offset; /* [base+offset] */
        bool address = false, negated = false;
    };

    operand one()
    {
        operand o;
        std::string word = take();
        if (word == "!") o.negated = true, word = take();
        if (word == "{") {
            for (; peek() != "}";)
                if (peek() == ",") take();
                else o.vector.push_back(take());
            take();
        } else if (word == "[") {
            o.address = true;
            o.base = take();
            o.offset = "0";
            if (peek() == "+") {
                take();
                o.offset = take();
                if (o.offset == "-") o.offset += take();
            }
            expect("]");
        } else if (word == "-") {
            o.word = "-" + take();
        } else {
            o.word = word;
            if (peek() == "|") take(), o.second = take();
        }
        return o;
    }

    std::vector<operand> operands()
    {
        std::vector<operand> all;
        while (peek() != ";") {
            if (peek() == ",") take();
            else all.push_back(one());
        }
        take();
        return all;
    }

    std::string symbol_address(const std::string &word)
    {
        auto found = symbols.find(word);
        if (found == symbols.end()) refuse("the symbol " + word);
        if (found->second == 's') return text_of(shared_place[word]) + "u";
        if (found->second == 'd') return "(u64)SHARED";
        return "(u64)(uintptr_t)" + name_of(word);
    }

    /* Bits of a register, number or address. */
    std::string bits(const std::string &word)
    {
        static const std::map<std::string, std::string> special = {
            { "%tid.x", "threadIdx.x" },     { "%tid.y", "threadIdx.y" },     { "%tid.z", "threadIdx.z" },     { "%ntid.x", "blockDim.x" },
            { "%ntid.y", "blockDim.y" },     { "%ntid.z", "blockDim.z" },     { "%ctaid.x", "blockIdx.x" },    { "%ctaid.y", "blockIdx.y" },
            { "%ctaid.z", "blockIdx.z" },    { "%nctaid.x", "gridDim.x" },    { "%nctaid.y", "gridDim.y" },    { "%nctaid.z", "gridDim.z" },
            { "%laneid", "ptx_lane()" },     { "WARP_SZ", "32" }
        };
        auto found = special.find(word);
        if (found != special.end()) return "(u64)" + found->second;
        if (word[0] == '%') return "(u64)" + name_of(word);
        if (word.compare(0, 2, "0f") == 0 || word.compare(0, 2, "0F") == 0) return "0x" + word.substr(2) + "u";
        if (word.compare(0, 2, "0d") == 0 || word.compare(0, 2, "0D") == 0) return "0x" + word.substr(2) + "ull";
        if (isdigit((unsigned char)word[0]) || word[0] == '-') {
            std::string number = word;
            if (number.back() == 'U') number.pop_back();
            if (number == "-9223372036854775808") return "0x8000000000000000ull";
            return "(u64)" + number + (number[0] == '-' ? "ll" : "ull");
        }
        return symbol_address(word);
    }

    std::string value(const operand &o, const std::string &type)
    {
        if (type == "pred") return std::string(o.negated ? "!" : "") + (o.word[0] == '%' ? name_of(o.word) : "(" + o.word + " != 0)");
        return "as<" + type + ">(" + bits(o.word) + ")";
    }

    void set(const operand &o, const std::string &type, const std::string &expression)
    {
        if (o.word == "_") return;
        if (type == "pred") out += name_of(o.word) + " = " + expression + ";\n";
        else out += name_of(o.word) + " = bits_of<" + type + ">(" + expression + ");\n";
    }

    std::string address(const operand &o, const words &parts)
    {
        std::string base = o.base[0] == '%' ? bits(o.base) : symbol_address(o.base);
        const bool inside = has(parts, "shared") || (o.base[0] != '%' && (symbols[o.base] == 's' || symbols[o.base] == 'd'));
        base = "(" + base + " + (u64)(s64)(" + o.offset + "))";
        return inside ? "shared_at(" + base + ")" : base;
    }

    /* ---- statements ---- */

    void statement(std::string word)
    {
        if (word == ".reg") return registers();
        if (word == ".local" || word == ".param") {
            size_t bytes;
            std::string align, type;
            const std::string name = described(&bytes, &align, &type);
            symbols[name] = 'l';
            out += "alignas(" + align + ") u8 " + name_of(name) + "[" + text_of(bytes) + "];\n";
            return expect(";");
        }
        if (word == ".shared") return variable(word);
        if (word == ".pragma") {
            while (take() != ";") {}
            return;
        }
        if (word == ";") return;
        std::string guard;
        if (word == "@") {
            const bool negated = peek() == "!";
            if (negated) take();
            guard = std::string("if (") + (negated ? "!" : "") + name_of(take()) + ") ";
            word = take();
        }
        if (!guard.empty()) out += guard + "{\n";
        const words parts = parts_of(word);
        if (parts[0] == "call") call();
        else instruction(word, parts, operands());
        if (!guard.empty()) out += "}\n";
    }

    void registers()
    {
        const std::string type = take().substr(1);
        const char *cpp = type == "pred" ? "bool" : bytes_of(type) == 8 ? "u64" : bytes_of(type) == 4 ? "u32" : "u16";
        for (bool more = true; more;) {
            const std::string name = take();
            if (peek() == "<") {
                take();
                const int n = atoi(take().c_str());
                expect(">");
                for (int i = 1; i < n; i++) out += std::string(i == 1 ? std::string(cpp) + " " : ", ") + name_of(name) + std::to_string(i) + " = 0";
                if (n > 1) out += ";\n";
            } else {
                out += std::string(cpp) + " " + name_of(name) + " = 0;\n";
            }
            more = take() == ",";
        }
    }

    void call()
    {
        std::string result = "nullptr";
        if (peek() == "(") {
            take();
            result = name_of(take());
            expect(")");
            expect(",");
        }
        const std::string callee = take();
        words given;
        if (peek() == ",") {
            take();
            expect("(");
            while (peek() != ")")
                if (peek() == ",") take();
                else given.push_back(take());
            take();
        }
        expect(";");
        out += "{ void *given_[] = { ";
        for (const std::string &name : given) out += name_of(name) + ", ";
        out += "nullptr }; " + name_of(callee) + "(" + result + ", given_); }\n";
    }

    void instruction(const std::string &word, const words &parts, const std::vector<operand> &o)
    {
        const std::string &name = parts[0], type = parts.back();
        const size_t n = o.size();
        auto binary = [&](const std::string &expression) { set(o[0], type, expression); };
        auto a = [&](size_t i) { return value(o.at(i), type); };
        auto u = [&](size_t i) { return value(o.at(i), "u32"); };
        const bool integer = type[0] == 's' || type[0] == 'u' || type[0] == 'b', floating = type[0] == 'f';
        const std::string as_type = "(" + type + ")";
        if (name == "bra") {
            out += "goto " + name_of(o.at(0).word) + ";\n";
        } else if (name == "brx") {
            out += "switch (" + u(0) + ") {\n";
            for (size_t i = 0; i < tables[o.at(1).word].size(); i++) out += "case " + text_of(i) + ": goto " + name_of(tables[o[1].word][i]) + ";\n";
            out += "}\n";
        } else if (name == "ret" || name == "exit") {
            out += "return;\n";
        } else if (name == "trap") {
            out += "ptx_stop(\"" + kernel + "\", \"trap\");\n";
        } else if (name == "mov") {
            move(o, type);
        } else if (name == "ld" || name == "ldu") {
            const size_t vector = o.at(0).vector.empty() ? 1 : o[0].vector.size();
            out += "{ const u64 from = " + address(o.at(1), parts) + ";\n";
            for (size_t k = 0; k < vector; k++)
                out += name_of(vector > 1 ? o[0].vector[k] : o[0].word) + " = ptx_load<" + type + ">(\"" + kernel + "\", from, " + text_of(vector) + ", " + text_of(k) + ");\n";
            out += "}\n";
        } else if (name == "st") {
            const size_t vector = o.at(1).vector.empty() ? 1 : o[1].vector.size();
            out += "{ const u64 to = " + address(o.at(0), parts) + ";\n";
            for (size_t k = 0; k < vector; k++)
                out += "ptx_store<" + type + ">(\"" + kernel + "\", to, " + text_of(vector) + ", " + text_of(k) + ", " + bits(vector > 1 ? o[1].vector[k] : o[1].word) + ");\n";
            out += "}\n";
        } else if (name == "cvta") {
            const std::string from = bits(o.at(1).word);
            if (has(parts, "shared")) set(o[0], type, has(parts, "to") ? "shared_address(" + from + ")" : "shared_at(" + from + ")");
            else set(o[0], type, from);
        } else if (name == "cvt") {
            convert(o, parts);
        } else if (name == "setp") {
            compare(o, parts);
        } else if (name == "selp") {
            binary(value(o.at(3), "pred") + " ? " + a(1) + " : " + a(2));
        } else if (name == "add" || name == "sub" || name == "addc" || name == "subc") {
            carry(name, parts, o, type);
        } else if ((name == "mad" || name == "madc") && (has(parts, "cc") || name == "madc")) {
            const std::string product = has(parts, "hi") ? "ptx_mul_hi<" + type + ">(" + a(1) + ", " + a(2) + ")" : as_type + "(" + a(1) + " * " + a(2) + ")";
            out += "{ const unsigned __int128 sum_ = (unsigned __int128)(" + product + ") + " + a(3) + (name == "madc" ? " + carry_" : "") + ";\n";
            set(o[0], type, as_type + "sum_");
            if (has(parts, "cc")) out += "carry_ = (u64)(sum_ >> " + text_of(8 * bytes_of(type)) + ") & 1;\n";
            out += "}\n";
            need_carry();
        } else if (name == "mul" || name == "mad") {
            const bool wide = has(parts, "wide"), high = has(parts, "hi");
            const std::string result = wide ? type.substr(0, 1) + std::to_string(16 * bytes_of(type)) : type;
            std::string product = floating ? a(1) + " * " + a(2)
                                  : wide   ? "(" + result + ")" + a(1) + " * (" + result + ")" + a(2)
                                  : high   ? "ptx_mul_hi<" + type + ">(" + a(1) + ", " + a(2) + ")"
                                           : "(" + type + ")((u64)" + a(1) + " * (u64)" + a(2) + ")";
            if (name == "mad" && floating) product = "std::fma(" + a(1) + ", " + a(2) + ", " + a(3) + ")";
            else if (name == "mad") product = "(u64)(" + product + ") + (u64)" + value(o.at(3), result);
            set(o[0], result, "(" + result + ")(" + product + ")");
        } else if (name == "fma") {
            binary("std::fma(" + a(1) + ", " + a(2) + ", " + a(3) + ")");
        } else if (name == "div") {
            binary("ptx_div<" + type + ">(" + a(1) + ", " + a(2) + ")");
        } else if (name == "rem") {
            binary("ptx_rem<" + type + ">(" + a(1) + ", " + a(2) + ")");
        } else if (name == "min" || name == "max") {
            binary("ptx_" + name + "<" + type + ">(" + a(1) + ", " + a(2) + ")");
        } else if (name == "neg") {
            binary(floating ? "-" + a(1) : as_type + "(0 - (u64)" + a(1) + ")");
        } else if (name == "abs") {
            binary(floating ? "std::fabs(" + a(1) + ")" : as_type + "(" + a(1) + " < 0 ? 0 - (u64)" + a(1) + " : (u64)" + a(1) + ")");
        } else if (name == "sqrt") {
            binary("std::sqrt(" + a(1) + ")");
        } else if (name == "rcp") {
            binary(type == "f64" && has(parts, "approx") ? "ptx_rcp_approximate(" + a(1) + ")" : "1 / " + a(1));
        } else if (name == "rsqrt") {
            binary(type == "f64" && has(parts, "ftz") ? "ptx_rsqrt_approximate(" + a(1) + ")" : "1 / std::sqrt(" + a(1) + ")");
        } else if (floating && (name == "sin" || name == "cos" || name == "tanh")) {
            binary("std::" + name + "(" + a(1) + ")");
        } else if (name == "ex2") {
            binary("std::exp2(" + a(1) + ")");
        } else if (name == "lg2") {
            binary("std::log2(" + a(1) + ")");
        } else if (name == "copysign") {
            binary("std::copysign(" + a(2) + ", " + a(1) + ")");
        } else if (name == "testp") {
            const std::string x = a(1);
            set(o[0], "pred", has(parts, "nan") || has(parts, "notanumber") ? x + " != " + x : has(parts, "infinite") ? "std::isinf(" + x + ")" : has(parts, "finite") ? "std::isfinite(" + x + ")" : (refuse(word), ""));
        } else if (name == "and" || name == "or" || name == "xor") {
            const char *sign = name == "and" ? " & " : name == "or" ? " | " : " ^ ";
            if (type == "pred") set(o[0], type, "(bool)(" + a(1) + sign + a(2) + ")");
            else binary(as_type + "(" + a(1) + sign + a(2) + ")");
        } else if (name == "not") {
            if (type == "pred") set(o[0], type, "!" + a(1));
            else binary(as_type + "~" + a(1));
        } else if (name == "shl" || name == "shr") {
            binary("ptx_" + name + "<" + type + ">(" + a(1) + ", " + u(2) + ")");
        } else if (name == "shf") {
            const std::string amount = has(parts, "wrap") ? "(" + u(3) + " & 31)" : u(3);
            binary(std::string(parts[1] == "l" ? "ptx_shf_left(" : "ptx_shf_right(") + a(1) + ", " + a(2) + ", " + amount + ")");
        } else if (name == "bfe") {
            binary("ptx_bfe<" + type + ">(" + a(1) + ", " + u(2) + ", " + u(3) + ")");
        } else if (name == "bfi") {
            binary("ptx_bfi<" + type + ">(" + a(1) + ", " + a(2) + ", " + u(3) + ", " + u(4) + ")");
        } else if (name == "lop3") {
            binary("ptx_lop3(" + a(1) + ", " + a(2) + ", " + a(3) + ", " + u(4) + ")");
        } else if (name == "prmt" && n == 4) {
            binary("ptx_prmt(" + a(1) + ", " + a(2) + ", " + a(3) + ")");
        } else if (name == "popc" || name == "clz" || name == "brev") {
            const bool wide = bytes_of(type) == 8;
            if (name == "brev" && wide) refuse(word);
            set(o[0], "u32", name == "brev" ? "ptx_brev(" + a(1) + ")" : name == "popc" ? "__builtin_popcountll(" + a(1) + ")" : a(1) + " ? __builtin_clz" + (wide ? "ll(" : "(") + a(1) + ") : " + (wide ? "64" : "32"));
        } else if (name == "bar" || name == "barrier") {
            if (has(parts, "warp")) out += "__syncwarp(" + u(0) + ");\n";
            else if (n == 1 && o[0].word == "0" && has(parts, "sync")) out += "__syncthreads();\n";
            else refuse(word);
        } else if (name == "shfl") {
            const size_t mode = has(parts, "sync") ? 2 : (refuse(word), 0);
            out += "{ bool there_; const u32 from_ = ptx_source('" + parts[mode].substr(0, 1) + "', " + u(2) + ", " + u(3) + ", &there_);\n";
            out += "const u32 value_ = __shfl_sync(" + u(4) + ", " + u(1) + ", (int)from_);\n";
            if (!o[0].second.empty()) out += name_of(o[0].second) + " = there_;\n";
            set(o[0], "u32", "value_");
            out += "}\n";
        } else if (name == "vote") {
            const std::string ballot = "__ballot_sync(" + u(2) + ", " + value(o.at(1), "pred") + ")";
            if (has(parts, "ballot")) set(o[0], "u32", ballot);
            else if (has(parts, "any")) set(o[0], "pred", ballot + " != 0");
            else if (has(parts, "all")) set(o[0], "pred", ballot + " == " + u(2));
            else refuse(word);
        } else if (name == "atom" || name == "red") {
            atomic(word, parts, o, type);
        } else if (name == "membar" || name == "fence") {
            out += "__threadfence();\n";
        } else {
            refuse("the instruction " + word);
        }
        (void)integer;
    }

    void need_carry() { if (out.find("u64 carry_ = 0;") == std::string::npos) out.insert(out.find("{\n") + 2, "    u64 carry_ = 0;\n"); }

    void carry(const std::string &name, const words &parts, const std::vector<operand> &o, const std::string &type)
    {
        const bool adds = name[0] == 'a', in = name.size() == 4, leaves = has(parts, "cc"), floating = type[0] == 'f';
        const std::string a = value(o.at(1), type), b = value(o.at(2), type), as_type = "(" + type + ")";
        if (floating) return set(o[0], type, a + (adds ? " + " : " - ") + b);
        if (!in && !leaves) return set(o[0], type, as_type + "((u64)" + a + (adds ? " + " : " - ") + "(u64)" + b + ")");
        const std::string wide = "u" + type.substr(1);
        out += "{ const unsigned __int128 sum_ = (unsigned __int128)" + value(o[1], wide) + (adds ? " + " : " - ") + value(o[2], wide) + (in ? adds ? " + carry_" : " - carry_" : "") + ";\n";
        set(o[0], type, as_type + "sum_");
        if (leaves) out += "carry_ = (u64)(sum_ >> " + text_of(8 * bytes_of(type)) + ") & 1;\n";
        out += "}\n";
        need_carry();
    }

    void move(const std::vector<operand> &o, const std::string &type)
    {
        if (type == "pred") return set(o.at(0), type, value(o.at(1), type));
        if (!o.at(0).vector.empty()) { /* apart */
            const size_t n = o[0].vector.size(), width = 8 * bytes_of(type) / n;
            out += "{ const u64 whole_ = " + bits(o.at(1).word) + ";\n";
            for (size_t k = 0; k < n; k++)
                if (o[0].vector[k] != "_") out += name_of(o[0].vector[k]) + " = (u" + text_of(width) + ")(whole_ >> " + text_of(k * width) + ");\n";
            out += "}\n";
        } else if (!o.at(1).vector.empty()) { /* together */
            const size_t n = o[1].vector.size(), width = 8 * bytes_of(type) / n;
            std::string whole = "0";
            for (size_t k = 0; k < n; k++) whole += " | (u64)(u" + text_of(width) + ")" + bits(o[1].vector[k]) + " << " + text_of(k * width);
            out += name_of(o[0].word) + " = " + whole + ";\n";
        } else {
            std::string from = bits(o[1].word);
            if (o[1].word[0] != '%' && symbols.count(o[1].word) && (symbols[o[1].word] == 'p')) from = "(u64)(uintptr_t)" + name_of(o[1].word);
            out += name_of(o[0].word) + " = " + from + ";\n";
        }
    }

    void convert(const std::vector<operand> &o, const words &parts)
    {
        const std::string to = parts.back().size() && parts.size() > 2 ? parts[parts.size() - 2] : "", from = parts.back();
        const std::string x = value(o.at(1), from);
        const char *how = has(parts, "rni") || has(parts, "rn") ? "RN" : has(parts, "rmi") || has(parts, "rm") ? "RM" : has(parts, "rpi") || has(parts, "rp") ? "RP" : "RZ";
        const bool whole = has(parts, "rni") || has(parts, "rzi") || has(parts, "rmi") || has(parts, "rpi");
        if (to[0] == 'f' && from[0] == 'f') {
            std::string y = whole ? "ptx_round<" + from + ">(" + x + ", " + how + ")" : "(" + to + ")" + x;
            if (has(parts, "sat")) y = "ptx_min<" + to + ">(ptx_max<" + to + ">(" + y + ", 0), 1)";
            set(o[0], to, "(" + to + ")" + y);
        } else if (to[0] != 'f' && from[0] == 'f') {
            set(o[0], to, "ptx_to_int<" + to + ">(" + x + ", " + how + ")");
        } else {
            if (has(parts, "sat")) refuse("cvt.sat between integers");
            set(o[0], to, "(" + to + ")" + x);
        }
    }

    void compare(const std::vector<operand> &o, const words &parts)
    {
        const std::string type = parts.back(), a = value(o.at(1), type), b = value(o.at(2), type);
        static const std::map<std::string, const char *> signs = { { "eq", "==" }, { "ne", "!=" }, { "lt", "<" }, { "le", "<=" }, { "gt", ">" }, { "ge", ">=" },
                                                                   { "lo", "<" },  { "ls", "<=" }, { "hi", ">" }, { "hs", ">=" } };
        std::string how = parts[1], result;
        const std::string unordered = "(" + a + " != " + a + " || " + b + " != " + b + ")";
        if (how == "num") result = "!" + unordered;
        else if (how == "nan") result = unordered;
        else if (signs.count(how)) {
            result = "(" + a + " " + signs.at(how) + " " + b + ")";
            if (how == "ne" && type[0] == 'f') result = "(!" + unordered + " && " + result + ")";
        } else if (how.size() == 3 && how[2] == 'u' && signs.count(how.substr(0, 2))) {
            result = "(" + unordered + " || " + a + " " + signs.at(how.substr(0, 2)) + " " + b + ")";
        } else {
            refuse("setp." + how);
        }
        const char *join = has(parts, "and") ? " && " : has(parts, "or") ? " || " : nullptr;
        if (has(parts, "xor")) refuse("setp with xor");
        out += "{ const bool c_ = " + result + ";\n";
        if (!o[0].second.empty() && o[0].second != "_") out += name_of(o[0].second) + " = !c_" + (join ? join + value(o.at(3), "pred") : "") + ";\n";
        if (o[0].word != "_") out += name_of(o[0].word) + " = c_" + (join ? join + value(o.at(3), "pred") : "") + ";\n";
        out += "}\n";
    }

    void atomic(const std::string &word, const words &parts, const std::vector<operand> &o, const std::string &type)
    {
        const size_t first = parts[0] == "red" ? 0 : 1;
        if (type[0] == 'f') refuse("a floating-point atomic (" + word + "): its order is not fixed");
        const std::string at = "(" + type + " *)(uintptr_t)" + address(o.at(first), parts), b = value(o.at(first + 1), type);
        std::string call;
        if (has(parts, "cas")) call = "atomicCAS(" + at + ", " + b + ", " + value(o.at(first + 2), type) + ")";
        else if (has(parts, "add")) call = "atomicAdd(" + at + ", " + b + ")";
        else if (has(parts, "max")) call = "atomicMax(" + at + ", " + b + ")";
        else if (has(parts, "min")) call = "atomicMin(" + at + ", " + b + ")";
        else if (has(parts, "or")) call = "atomicOr(" + at + ", " + b + ")";
        else if (has(parts, "exch")) call = "atomicExch(" + at + ", " + b + ")";
        else refuse(word);
        if (first) set(o[0], type, call);
        else out += call + ";\n";
    }
};
} // namespace

bool ptx_to_cpp(const std::string &ptx, std::string *cpp, std::string *error)
{
    try {
        *cpp = translator(ptx).run();
        return true;
    } catch (const failure &f) {
        *error = "PTX: not known: " + f.what;
    } catch (const std::exception &) {
        *error = "PTX: an instruction has too few operands";
    }
    return false;
}

namespace
{
std::string read_whole(const std::string &path)
{
    std::stringstream read;
    read << std::ifstream(path, std::ios::binary).rdbuf();
    return read.str();
}

/* Objects of earlier programs and contexts: in the cache of the tests, or nowhere. */
std::string kept_at(const std::string &cpp, const std::string &compile)
{
    const char *folder = getenv("HAIRGRAD_CACHE");
    if (!folder || !*folder) return "";
    char name[64];
    std::string all = compile + cpp;
    for (const char *header : { "/shim.h", "/table.h", "/ptx_runtime.h" }) all += read_whole(EMULATOR_SOURCE + std::string(header));
    snprintf(name, sizeof name, "/ptx-%016zx%016zx.so", std::hash<std::string>()(all), std::hash<std::string>()("again" + all));
    return folder + std::string(name);
}
} // namespace

/* Plain additions and products are kept apart and fma is one rounding, as the instructions say. */
bool ptx_to_object(const std::string &ptx, std::string *object, std::string *error)
{
    std::string cpp;
    if (!ptx_to_cpp(ptx, &cpp, error)) return false;
    const std::string compiler = getenv("CXX") ? getenv("CXX") : "c++",
                      compile = compiler + " -std=c++17 -O1 -w -fPIC -shared -fno-gnu-unique -fvisibility=hidden -ffp-contract=off -I'" EMULATOR_SOURCE "'", kept = kept_at(cpp, compile);
    if (!kept.empty() && !(*object = read_whole(kept)).empty()) return true;
    char folder[] = "/tmp/emulated-ptx-XXXXXX";
    if (!mkdtemp(folder)) return *error = "PTX: no temporary folder", false;
    const std::string at = folder;
    std::ofstream(at + "/source.cc") << cpp;
    const std::string command = compile + " '" + at + "/source.cc' -o '" + at + "/object.so' > '" + at + "/log' 2>&1";
    const bool good = system(command.c_str()) == 0;
    *(good ? object : error) = read_whole(at + (good ? "/object.so" : "/log"));
    if (good && !kept.empty()) { /* under its name at once, or not at all */
        const std::string part = kept + "." + std::to_string(getpid());
        std::ofstream(part, std::ios::binary) << *object;
        if (rename(part.c_str(), kept.c_str()) != 0) remove(part.c_str());
    }
    if (system(("rm -rf '" + at + "'").c_str()) != 0) fprintf(stderr, "emulator: %s was left\n", folder);
    return good;
}
