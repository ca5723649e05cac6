// pathfold for C++17: pathfold.h with exceptions for statuses and objects that clean up after themselves.
#pragma once

#include <cstddef>
#include <cstdint>
#include <exception>
#include <functional>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "pathfold/pathfold.h"

namespace pathfold {

/// A call that failed; what() names the argument, what was given and what would be right.
class Error : public std::runtime_error {
public:
    Error(pathfold_status status, const std::string &message)
        : std::runtime_error(message), status_(status) {}
    pathfold_status status() const { return status_; }
    const char *code() const { return pathfold_status_name(status_); } ///< "invalid-argument", ...

private:
    pathfold_status status_;
};

/// Throws an Error unless `status` is PATHFOLD_OK.
inline void check(pathfold_status status) {
    if (status != PATHFOLD_OK)
        throw Error(status, pathfold_last_error());
}

/// A name as C takes it. Throws an Error where it holds a zero byte, at which C would end it.
inline const char *c_name(const std::string &name) {
    if (name.find('\0') != std::string::npos)
        throw Error(PATHFOLD_INVALID_ARGUMENT,
                    "the name \"" + std::string(name.c_str()) + "...\" holds a zero byte; give it without");
    return name.c_str();
}

/// The version of the library.
inline std::string version() { return pathfold_version(); }

/// Names the onnxruntime library to load, before the first model.
inline void set_onnxruntime(const std::string &path) { check(pathfold_set_onnxruntime(c_name(path))); }

/// The folder of a model, by name or folder; see pathfold_find_model.
inline std::string find_model(const std::string &name, const std::vector<std::string> &folders = {}) {
    std::vector<const char *> pointers;
    for (const std::string &folder : folders)
        pointers.push_back(c_name(folder));
    const char *path = nullptr;
    check(pathfold_find_model(c_name(name), pointers.data(), pointers.size(), &path));
    return path;
}

/// A view of pixels that the caller keeps; strides in bytes.
using Image = pathfold_image;

/// A view of densely packed float pixels, height x width x channels.
inline Image image(const float *data, int64_t height, int64_t width, int64_t channels) {
    return pathfold_packed(const_cast<float *>(data), PATHFOLD_FLOAT32, 1, height, width, channels);
}

/// A view of densely packed float samples, samples x height x width x channels.
inline Image samples(const float *data, int64_t count, int64_t height, int64_t width, int64_t channels) {
    return pathfold_packed(const_cast<float *>(data), PATHFOLD_FLOAT32, count, height, width, channels);
}

/// Fills in one path: the channels of its descriptor, and its density unless null; see
/// pathfold_describe_path.
inline void describe_path(const pathfold_path &path, float *descriptor, float *density,
                          int vertices = PATHFOLD_MAX_VERTICES) {
    check(pathfold_describe_path(&path, vertices, descriptor, density));
}

/// How a model is loaded; see pathfold_model_options.
struct ModelOptions {
    std::string provider = "cpu";   ///< "cpu", "cuda", ...
    std::string precision = "auto"; ///< "fp32", "int8" or "auto", the faster one
    int threads = 0;                ///< 0: all
};

/// A model folder, checked and loaded. Immutable; copies share it, on any number of threads.
class Model {
public:
    /// `name`: a folder or the name of a model.
    explicit Model(const std::string &name, const ModelOptions &options = {}) {
        pathfold_model_options c = pathfold_model_options_init();
        c.provider = c_name(options.provider);
        c.precision = c_name(options.precision);
        c.threads = options.threads;
        pathfold_model *model = nullptr;
        check(pathfold_model_load(c_name(name), &c, &model));
        model_.reset(model, pathfold_model_release);
    }

    std::string manifest() const { return pathfold_model_manifest(model_.get()); } ///< JSON
    std::string folder() const { return pathfold_model_folder(model_.get()); }
    std::string precision() const { return pathfold_model_precision(model_.get()); } ///< "fp32" or "int8"
    pathfold_model *get() const { return model_.get(); }

private:
    std::shared_ptr<pathfold_model> model_;
};

/// One model applied to frames. Pixels that are set must live until run() is over. One call at a time: others
/// are refused while it runs, see pathfold_denoiser.
class Denoiser {
public:
    explicit Denoiser(const Model &model) {
        pathfold_denoiser *denoiser = nullptr;
        check(pathfold_denoiser_create(model.get(), &denoiser));
        denoiser_.reset(denoiser);
    }

    Denoiser &input(const std::string &name, const Image &image) {
        check(pathfold_denoiser_set_input(get(), c_name(name), &image));
        return *this;
    }
    Denoiser &output(const std::string &name, const Image &image) {
        check(pathfold_denoiser_set_output(get(), c_name(name), &image));
        return *this;
    }
    /// A layer is given as the part "color", or as "diffuse" and "specular".
    Denoiser &layer(const std::string &name, const std::string &part, const Image &image) {
        check(pathfold_denoiser_set_layer(get(), c_name(name), c_name(part), &image));
        return *this;
    }
    Denoiser &layer_output(const std::string &name, const Image &image) {
        check(pathfold_denoiser_set_layer_output(get(), c_name(name), &image));
        return *this;
    }
    /// "exposure", "memory_mb", "tile" or "samples_per_pixel"; see pathfold_denoiser_set_number.
    Denoiser &set(const std::string &name, double value) {
        check(pathfold_denoiser_set_number(get(), c_name(name), value));
        return *this;
    }
    /// "all", "none", or names; see pathfold_denoiser_set_leave_out.
    Denoiser &leave_out(const std::string &names) {
        check(pathfold_denoiser_set_leave_out(get(), c_name(names)));
        return *this;
    }
    /// Whether the inputs that are set are split, so that "diffuse" and "specular" can be had.
    bool is_split() const { return pathfold_denoiser_is_split(get()) != 0; }
    /// Takes inputs, outputs and layers away and gives the working memory back; settings stay.
    void clear() { check(pathfold_denoiser_clear(get())); }

    /// What a run of what is set would come to, by sizes alone; see pathfold_denoiser_plan.
    pathfold_plan plan() const {
        pathfold_plan plan = pathfold_plan_init();
        check(pathfold_denoiser_plan(get(), &plan));
        return plan;
    }

    /// Denoises; `progress` is told the part done and returns false to cancel. Returns the report, as JSON.
    /// An exception from `progress` cancels and comes out of run().
    std::string run(const std::function<bool(float)> &progress = nullptr) {
        Caller caller{progress, nullptr};
        check(pathfold_denoiser_set_progress(get(), progress ? &Caller::call : nullptr, &caller));
        const pathfold_status status = pathfold_denoiser_run(get());
        pathfold_denoiser_set_progress(get(), nullptr, nullptr);
        if (caller.exception)
            std::rethrow_exception(caller.exception);
        check(status);
        return pathfold_denoiser_report(get());
    }

    /// Ends the run that is going on, from another thread; see pathfold_denoiser_cancel.
    void cancel() { pathfold_denoiser_cancel(get()); }

    pathfold_denoiser *get() const { return denoiser_.get(); }

private:
    /// Carries a C++ callback, and what it throws, through the C interface.
    struct Caller {
        const std::function<bool(float)> &progress;
        std::exception_ptr exception;

        static int call(void *user, float done) {
            Caller &self = *static_cast<Caller *>(user);
            try {
                return self.progress(done) ? 1 : 0;
            } catch (...) {
                self.exception = std::current_exception();
                return 0;
            }
        }
    };

    struct Release {
        void operator()(pathfold_denoiser *denoiser) const { pathfold_denoiser_release(denoiser); }
    };
    std::unique_ptr<pathfold_denoiser, Release> denoiser_;
};

} // namespace pathfold
