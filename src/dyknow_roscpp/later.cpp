// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include "later.h"

#include <ros/init.h>

#include <condition_variable>
#include <map>
#include <mutex>
#include <thread>


namespace dyknow
{
namespace
{

constexpr std::chrono::seconds PATIENCE{1};

class Worker
{
public:
  /// Leaked on purpose, as everything global here: threads outlive exit(), which would destroy it under them.
  static Worker& instance()
  {
    static Worker& worker = *new Worker;
    return worker;
  }

  void add(Clock::time_point due, std::function<void()> work)
  {
    std::lock_guard<std::mutex> lock(state_lock_);
    work_.emplace(due, std::move(work));
    changed_.notify_all();
  }

  void end()
  {
    std::unique_lock<std::mutex> lock(state_lock_);
    is_ended_ = true;
    changed_.wait_until(lock, forWaiting(Clock::now() + PATIENCE), [this] { return !is_busy_; });
  }

private:
  Worker() { std::thread(&Worker::run, this).detach(); }

  void run()
  {
    for (;;)
    {
      const auto work = next();
      if (!ros::isShuttingDown())
      {
        work();
      }
    }
  }

  std::function<void()> next()
  {
    std::unique_lock<std::mutex> lock(state_lock_);
    is_busy_ = false;
    changed_.notify_all();
    for (;;)
    {
      if (work_.empty() || is_ended_)
      {
        changed_.wait(lock);
      }
      else if (const auto due = work_.begin()->first; due > Clock::now())
      {
        changed_.wait_until(lock, forWaiting(due));
      }
      else
      {
        auto work = std::move(work_.begin()->second);
        work_.erase(work_.begin());
        is_busy_ = true;
        return work;
      }
    }
  }

  std::mutex state_lock_;
  std::condition_variable changed_;
  bool is_busy_ = false;
  bool is_ended_ = false;
  std::multimap<Clock::time_point, std::function<void()>> work_;
};

}  // namespace

void later(std::function<void()> work, Clock::time_point due)
{
  Worker::instance().add(due, std::move(work));
}

void endLaterWork()
{
  Worker::instance().end();
}

}  // namespace dyknow
