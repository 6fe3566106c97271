// What calls of the C interface share: memory that is kept between them, and their status (guarded.h).
#pragma once
#include "support/guarded.h"

#include <memory>
#include <mutex>
#include <vector>

namespace cags {

// A `Scratch` for the life of one call, kept for the next one: fresh pages cost more than the work on them.
template <typename Scratch>
class Lease {
 public:
  Lease() {
    std::lock_guard lock(mutex());
    if (idle().empty()) {
      scratch_ = std::make_unique<Scratch>();
    } else {
      scratch_ = std::move(idle().back());
      idle().pop_back();
    }
  }
  ~Lease() {
    std::lock_guard lock(mutex());
    idle().push_back(std::move(scratch_));
  }
  Lease(const Lease&) = delete;
  Lease& operator=(const Lease&) = delete;
  Scratch* operator->() const { return scratch_.get(); }
  Scratch& operator*() const { return *scratch_; }

 private:
  static std::mutex& mutex() {
    static std::mutex instance;
    return instance;
  }
  static std::vector<std::unique_ptr<Scratch>>& idle() {
    static auto* instance = new std::vector<std::unique_ptr<Scratch>>;  // never destroyed: see Pool
    return *instance;
  }
  std::unique_ptr<Scratch> scratch_;
};

}  // namespace cags
