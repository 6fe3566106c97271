#include "support/thread_pool.h"

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <mutex>
#include <system_error>
#include <thread>
#include <vector>

namespace cags {
namespace {

struct Job {
  const std::function<void(int, int)>& body;
  int count;
  int helpers_wanted;
  std::atomic<int> next{0};
  int helpers_joined = 0, helpers_active = 0;  // guarded by the pool's mutex

  void work(int worker) {
    for (int index; (index = next.fetch_add(1, std::memory_order_relaxed)) < count;) body(index, worker);
  }
};

class Pool {
 public:
  static Pool& instance() {
    static Pool* pool = new Pool;  // never destroyed: threads may outlive static destructors
    return *pool;
  }

  void run(Job& job) {
    {
      std::lock_guard lock(mutex_);
      grow(job.helpers_wanted);
      jobs_.push_back(&job);
    }
    for (int i = 0; i < job.helpers_wanted; i++) work_.notify_one();
    job.work(0);
    std::unique_lock lock(mutex_);
    jobs_.erase(std::find(jobs_.begin(), jobs_.end(), &job));
    done_.wait(lock, [&] { return job.helpers_active == 0; });
  }

 private:
  void grow(int helpers) {
    while (threads_ < helpers) {
      try {
        std::thread([this] { serve(); }).detach();
      } catch (const std::system_error&) {
        return;  // the caller does the work alone
      }
      threads_++;
    }
  }

  Job* open_job() {
    auto wants = [](const Job* job) { return job->helpers_joined < job->helpers_wanted; };
    auto found = std::find_if(jobs_.begin(), jobs_.end(), wants);
    return found == jobs_.end() ? nullptr : *found;
  }

  void serve() {
    std::unique_lock lock(mutex_);
    for (;;) {
      Job* job = nullptr;
      work_.wait(lock, [&] { return (job = open_job()) != nullptr; });
      const int worker = ++job->helpers_joined;
      job->helpers_active++;
      lock.unlock();
      job->work(worker);
      lock.lock();
      if (--job->helpers_active == 0) done_.notify_all();
    }
  }

  std::mutex mutex_;
  std::condition_variable work_, done_;
  std::vector<Job*> jobs_;
  int threads_ = 0;
};

}  // namespace

void parallel_for(int threads, int count, const std::function<void(int, int)>& body) {
  const int helpers = std::min({threads, count, kMaxThreads}) - 1;
  Job job{body, count, helpers};
  if (helpers <= 0) return job.work(0);
  Pool::instance().run(job);
}

}  // namespace cags
