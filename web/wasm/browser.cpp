// What the browser's module has besides the kernels: one thread, memory for the caller, and rows as the GPU takes them.
#include "cags_kernels.h"
#include "support/thread_pool.h"

#include <cstdlib>
#include <cstring>

namespace cags {

void parallel_for(int, int count, const std::function<void(int index, int worker)>& body) {
  for (int index = 0; index < count; index++) body(index, 0);
}

}  // namespace cags

CAGS_API void* cags_web_allocate(uint32_t bytes) { return std::aligned_alloc(16, (bytes + 15) & ~15u); }
CAGS_API void cags_web_free(void* memory) { std::free(memory); }

// Columns of splats by id, as words: float32 bits are copied, never touched.
struct CagsWebSplats {
  const uint32_t *means, *quats, *log_scales, *logits, *sh0, *sh_rest;  // 3, 4, 3, 1, 3 and sh_words a row
  int32_t sh_words;
};

// Rows as update.wgsl stages them: the row, mean, logit, quaternion; with `all` also log scales, base colour, harmonics.
CAGS_API void cags_web_pack(const CagsWebSplats* splats, int32_t count, const int32_t* rows, int32_t all, uint32_t* out) {
  const CagsWebSplats s = *splats;
  for (const int32_t* row = rows; row < rows + count; row++) {
    const size_t at = *row;
    *out++ = static_cast<uint32_t>(*row);
    std::memcpy(out, s.means + 3 * at, 12), out += 3;
    *out++ = s.logits[at];
    std::memcpy(out, s.quats + 4 * at, 16), out += 4;
    if (!all) continue;
    std::memcpy(out, s.log_scales + 3 * at, 12), out += 3;
    std::memcpy(out, s.sh0 + 3 * at, 12), out += 3;
    std::memcpy(out, s.sh_rest + s.sh_words * at, 4 * size_t(s.sh_words)), out += s.sh_words;
  }
}
