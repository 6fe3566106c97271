// A grow-only array on a cache-line boundary.
#pragma once
#include <cstddef>
#include <cstdlib>
#include <new>
#include <utility>

namespace cags {

inline constexpr size_t kCacheLine = 64;

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
      const size_t bytes = (wanted * sizeof(T) + kCacheLine - 1) / kCacheLine * kCacheLine;
      data_ = static_cast<T*>(std::aligned_alloc(kCacheLine, bytes));
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
