#include "watched_run.h"

#include <condition_variable>
#include <exception>
#include <future>
#include <memory>
#include <mutex>
#include <optional>

namespace py = pybind11;

namespace {

/// Where the thread that works and the one that Python called from meet.
class Meeting {
public:
    Meeting(Call &call, pathfold::Denoiser &denoiser, const py::object &progress)
        : call_(call), denoiser_(denoiser), progress_(progress) {}

    /// By the thread that works: whether to go on.
    bool ask(float done) {
        std::unique_lock<std::mutex> lock(mutex_);
        asked_ = done;
        changed_.notify_all();
        changed_.wait(lock, [&] { return !asked_; });
        return goes_on_;
    }
    void end() {
        const std::lock_guard<std::mutex> lock(mutex_);
        over_ = true;
        changed_.notify_all();
    }

    /// By the other one, without the GIL: answers until the end.
    void attend() {
        std::unique_lock<std::mutex> lock(mutex_);
        while (!over_) {
            changed_.wait_for(lock, Call::interval, [&] { return over_ || asked_; });
            if (!over_)
                answer();
        }
    }

    /// What Python raised; null: nothing.
    std::exception_ptr raised() const { return raised_; }

private:
    void answer() {
        if (raised_ || call_.is_ending())
            goes_on_ = false;
        else
            call_.taken([&] { answer_in_python(); });
        if (!goes_on_ && !asked_)
            denoiser_.cancel();
        asked_.reset();
        changed_.notify_all();
    }

    void answer_in_python() {
        try {
            check_signals();
            if (asked_)
                goes_on_ = is_yes(progress_(*asked_));
        } catch (...) {
            raised_ = std::current_exception();
            goes_on_ = false;
        }
    }

    /// None goes on too: a callback need not return anything.
    static bool is_yes(const py::object &answer) {
        if (answer.is_none())
            return true;
        const int truth = PyObject_IsTrue(answer.ptr());
        if (truth < 0)
            throw py::error_already_set();
        return truth != 0;
    }

    Call &call_;
    pathfold::Denoiser &denoiser_;
    const py::object &progress_;
    std::mutex mutex_;
    std::condition_variable changed_;
    std::optional<float> asked_; // the part done, until it is answered
    bool goes_on_ = true, over_ = false;
    std::exception_ptr raised_;
};

} // namespace

std::string run_watched(Call &call, pathfold::Denoiser &denoiser, const py::object &progress) {
    Meeting meeting(call, denoiser, progress);
    std::function<bool(float)> ask;
    if (!progress.is_none())
        ask = [&](float done) { return meeting.ask(done); };
    std::future<std::string> report;
    call.released([&] {
        report = std::async(std::launch::async, [&] {
            const std::shared_ptr<Meeting> over(&meeting, [](Meeting *its) { its->end(); });
            return denoiser.run(ask);
        });
        meeting.attend();
        report.wait();
    });
    if (meeting.raised())
        std::rethrow_exception(meeting.raised());
    return report.get();
}
