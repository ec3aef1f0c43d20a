/* From PTX, as the real NVRTC makes it, to C++ for the emulating driver: what was really emitted is run. */
#ifndef EMULATOR_PTX_H
#define EMULATOR_PTX_H

#include <string>

/* false: `error` says which instruction or directive is not known. */
bool ptx_to_cpp(const std::string &ptx, std::string *cpp, std::string *error);

/* The same, and compiled: a shared object with the kernels, as libnvrtc.cc makes one. */
bool ptx_to_object(const std::string &ptx, std::string *object, std::string *error);

#endif
