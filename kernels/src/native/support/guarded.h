// What calls of the C interface return where memory runs out or something else is thrown.
#pragma once
#include "cags_kernels.h"

#include <new>

namespace cags {

template <typename Body>
int32_t guarded(const Body& body) {
#if defined(__cpp_exceptions)
  try {
    body();
    return CAGS_OK;
  } catch (const std::bad_alloc&) {
    return CAGS_OUT_OF_MEMORY;
  } catch (...) {
    return CAGS_FAILED;
  }
#else  // WebAssembly: whatever would be thrown traps, and the caller sees that
  body();
  return CAGS_OK;
#endif
}

}  // namespace cags
