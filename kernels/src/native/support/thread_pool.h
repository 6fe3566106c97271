// One pool of threads for the whole process. Nothing spins for long: the cores may be shared with other programs.
#pragma once
#include <functional>

namespace cags {

inline constexpr int kMaxThreads = 64;

// Calls body(index, worker) for every index in [0, count), on at most `threads` threads of which the caller is one;
// worker < threads tells which. Returns when all calls have. Calls from several threads run beside each other. The caller
// never waits for a thread that has not begun, so a pool without free (or, after a fork, without any) threads only makes
// it slower. `body` must not throw.
void parallel_for(int threads, int count, const std::function<void(int index, int worker)>& body);

}  // namespace cags
