// A grow-only array on a cache-line boundary; large ones ask for large pages.
#pragma once
#include <cstddef>
#include <cstdlib>
#include <new>
#include <utility>

#if defined(__linux__)
#include <sys/mman.h>
#endif

namespace cags {

inline constexpr size_t kCacheLine = 64;
inline constexpr size_t kLargePage = size_t{2} << 20;

// Memory for `bytes`, or null; std::free gives it back. A frame jumps about in megabytes of records and entries: with pages
// of 4 KiB every jump would miss the translation buffer as well as the cache.
inline void* allocate_aligned(size_t bytes) {
  const size_t unit = bytes >= 2 * kLargePage ? kLargePage : kCacheLine;
  const size_t whole = (bytes + unit - 1) / unit * unit;
  void* memory = std::aligned_alloc(unit, whole);
#if defined(__linux__)
  if (memory && unit == kLargePage) madvise(memory, whole, MADV_HUGEPAGE);  // a hint: refused, it only is slower
#endif
  return memory;
}

// Holds trivially copyable elements; growing forgets the old ones. Throws std::bad_alloc.
template <typename T>
class AlignedArray {
 public:
  AlignedArray() = default;
  AlignedArray(const AlignedArray&) = delete;
  AlignedArray& operator=(const AlignedArray&) = delete;
  ~AlignedArray() { std::free(data_); }

  // At least `count` elements, contents undefined where it had to grow; grows by a quarter more than asked.
  T* reserve(size_t count) {
    if (count > capacity_) {
      std::free(std::exchange(data_, nullptr));
      capacity_ = 0;
      const size_t wanted = count + count / 4;
      data_ = static_cast<T*>(allocate_aligned(wanted * sizeof(T)));
      if (!data_) throw std::bad_alloc();
      capacity_ = wanted;
    }
    return data_;
  }

  T* data() const { return data_; }
  T& operator[](size_t i) const { return data_[i]; }

 private:
  T* data_ = nullptr;
  size_t capacity_ = 0;
};

}  // namespace cags
