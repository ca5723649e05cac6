#include <atomic>
#include <cstring>
#include <memory>
#include <new>
#include <string>

#include "buffers.h"
#include "denoiser.h"
#include "descriptor.h"
#include "engine.h"
#include "error.h"
#include "model.h"
#include "pathfold/pathfold.h"
#include "prepare.h"
#include "process.h"
#include "radiance.h"
#include "reads.h"
#include "reconstruct.h"

using namespace pathfold::core;

struct pathfold_model {
    std::shared_ptr<const Model> model;
};

struct pathfold_denoiser {
    enum Use { none, call, released };

    Denoiser denoiser;
    Frame frame;
    Settings settings;
    std::string report = "{}";
    mutable std::atomic<Use> use{none};
    mutable Process user; // the process of the call that uses it

    explicit pathfold_denoiser(std::shared_ptr<const Model> model) : denoiser(std::move(model)) {}
};

namespace {

thread_local std::string last_error;
thread_local std::string found_path;

pathfold_status complain(pathfold_status status, const char *message) noexcept {
    try {
        last_error = message;
    } catch (...) {
        last_error.clear();
    }
    return status;
}

/// Runs an entry point's body; no exception leaves it.
template <typename Body>
pathfold_status guarded(const Body &body) noexcept {
    try {
        body();
        return PATHFOLD_OK;
    } catch (const Error &error) {
        return complain(error.status(), error.what());
    } catch (const std::bad_alloc &) {
        return complain(PATHFOLD_OUT_OF_MEMORY, "out of memory; set memory_mb, or denoise a smaller image");
    } catch (const std::exception &error) {
        return complain(PATHFOLD_INTERNAL, error.what());
    } catch (...) {
        return complain(PATHFOLD_INTERNAL, "an unknown exception");
    }
}

template <typename Pointer>
Pointer &given(Pointer *argument, const char *name) {
    if (argument == nullptr)
        fail(PATHFOLD_INVALID_ARGUMENT, name, " is a null pointer");
    return *argument;
}

/// One call's use of a denoiser: all others are refused meanwhile, from whatever thread, a run's own callback
/// included. Where the denoiser is given back meanwhile, it goes when the call is over.
template <typename Handle>
class Using {
public:
    explicit Using(Handle *denoiser) : at_(given(denoiser, "denoiser")) {
        auto use = pathfold_denoiser::none;
        if (!at_.use.compare_exchange_strong(use, pathfold_denoiser::call))
            fail(PATHFOLD_INVALID_ARGUMENT,
                 at_.user.is_this()
                     ? "the denoiser is running, or in another call; wait until that is over, or use another "
                       "one"
                     : "the denoiser was running when this process was forked; create another one here");
        at_.user.become_this();
    }
    ~Using() {
        auto use = pathfold_denoiser::call;
        if (!at_.use.compare_exchange_strong(use, pathfold_denoiser::none))
            delete &at_;
    }
    Using(const Using &) = delete;

    Handle *operator->() const { return &at_; }

private:
    Handle &at_;
};

std::string given_text(const char *argument, const char *name) {
    given(argument, name);
    return argument;
}

/// Copies what both sides know of a struct that starts with its size, which `to` keeps. Members are as large
/// as the struct is aligned, so an older header's struct ends at a multiple of that.
template <typename Struct>
void copy_known(const Struct &from, Struct &to, const char *name) {
    const size_t size = from.size;
    if (size < sizeof(size_t) || size % alignof(Struct) != 0)
        fail(PATHFOLD_INVALID_ARGUMENT, name, ": size is ", size, "; set it with pathfold_..._init");
    if (size > sizeof(Struct))
        fail(PATHFOLD_UNSUPPORTED, name, ": size is ", size,
             ", as of a newer pathfold.h than that of this pathfold, ", pathfold_version(), ", which knows ",
             sizeof(Struct), "; install the newer one");
    std::memcpy(&to, &from, size);
    to.size = sizeof(Struct);
}

} // namespace

const char *pathfold_status_name(pathfold_status status) {
    switch (status) {
    case PATHFOLD_OK:
        return "ok";
    case PATHFOLD_INVALID_ARGUMENT:
        return "invalid-argument";
    case PATHFOLD_NOT_FOUND:
        return "not-found";
    case PATHFOLD_INVALID_MODEL:
        return "invalid-model";
    case PATHFOLD_ENGINE:
        return "engine";
    case PATHFOLD_UNSUPPORTED:
        return "unsupported";
    case PATHFOLD_OUT_OF_MEMORY:
        return "out-of-memory";
    case PATHFOLD_CANCELLED:
        return "cancelled";
    case PATHFOLD_INTERNAL:
        break;
    }
    return "internal";
}

const char *pathfold_last_error(void) { return last_error.c_str(); }

#define TEXT_OF(number) #number
#define VERSION_TEXT(major, minor, patch) TEXT_OF(major) "." TEXT_OF(minor) "." TEXT_OF(patch)

const char *pathfold_version(void) {
    return VERSION_TEXT(PATHFOLD_VERSION_MAJOR, PATHFOLD_VERSION_MINOR, PATHFOLD_VERSION_PATCH);
}

pathfold_status pathfold_set_onnxruntime(const char *path) {
    return guarded([&] { set_onnxruntime(given_text(path, "path")); });
}

pathfold_status pathfold_find_model(const char *name, const char *const *folders, size_t folder_count,
                                    const char **path) {
    return guarded([&] {
        given(path, "path");
        std::vector<std::string> places;
        for (size_t i = 0; i < folder_count; ++i)
            places.push_back(given_text((&given(folders, "folders"))[i], "an entry of folders"));
        found_path = find_model(given_text(name, "name"), places);
        *path = found_path.c_str();
    });
}

pathfold_status pathfold_model_load(const char *name, const pathfold_model_options *options,
                                    pathfold_model **model) {
    return guarded([&] {
        given(model, "model");
        pathfold_model_options chosen = pathfold_model_options_init();
        if (options != nullptr)
            copy_known(*options, chosen, "options");
        if (chosen.threads < 0 || chosen.threads > 1024)
            fail(PATHFOLD_INVALID_ARGUMENT, "threads is ", chosen.threads,
                 "; it must be from 1 to 1024, or 0 for all");
        *model = new pathfold_model{std::make_shared<const Model>(
            given_text(name, "name"), chosen.provider != nullptr ? chosen.provider : "cpu", chosen.threads,
            chosen.precision != nullptr ? chosen.precision : "auto")};
    });
}

void pathfold_model_release(pathfold_model *model) { delete model; }

const char *pathfold_model_manifest(const pathfold_model *model) {
    return model != nullptr ? model->model->manifest().text.c_str() : "{}";
}

const char *pathfold_model_folder(const pathfold_model *model) {
    return model != nullptr ? model->model->folder().c_str() : "";
}

const char *pathfold_model_precision(const pathfold_model *model) {
    return model != nullptr ? model->model->precision().c_str() : "";
}

const pathfold_buffer *pathfold_buffers(size_t *count) {
    if (count != nullptr)
        *count = buffer_kinds().size();
    return buffer_kinds().data();
}

pathfold_status pathfold_describe_path(const pathfold_path *path, int vertices, float *descriptor,
                                       float *density) {
    return guarded(
        [&] { describe_path(given(path, "path"), vertices, &given(descriptor, "descriptor"), density); });
}

pathfold_status pathfold_denoiser_create(const pathfold_model *model, pathfold_denoiser **denoiser) {
    return guarded([&] {
        given(denoiser, "denoiser");
        *denoiser = new pathfold_denoiser(given(model, "model").model);
    });
}

void pathfold_denoiser_release(pathfold_denoiser *denoiser) {
    if (denoiser != nullptr && denoiser->use.exchange(pathfold_denoiser::released) == pathfold_denoiser::none)
        delete denoiser; // else the call that uses it does so
}

pathfold_status pathfold_denoiser_set_input(pathfold_denoiser *denoiser, const char *name,
                                            const pathfold_image *image) {
    return guarded([&] { Using(denoiser)->frame.set_input(given_text(name, "name"), image); });
}

pathfold_status pathfold_denoiser_set_output(pathfold_denoiser *denoiser, const char *name,
                                             const pathfold_image *image) {
    return guarded([&] { Using(denoiser)->frame.set_output(given_text(name, "name"), image); });
}

pathfold_status pathfold_denoiser_set_layer(pathfold_denoiser *denoiser, const char *layer, const char *part,
                                            const pathfold_image *image) {
    return guarded([&] {
        Using(denoiser)->frame.set_layer(given_text(layer, "layer"), given_text(part, "part"), image);
    });
}

pathfold_status pathfold_denoiser_set_layer_output(pathfold_denoiser *denoiser, const char *layer,
                                                   const pathfold_image *image) {
    return guarded([&] { Using(denoiser)->frame.set_layer_output(given_text(layer, "layer"), image); });
}

int pathfold_denoiser_is_split(const pathfold_denoiser *denoiser) {
    bool split = false;
    const pathfold_status status = guarded([&] {
        const Using at(denoiser);
        split = decide_reads(at->frame, at->denoiser.model().manifest(), at->settings).split;
    });
    return status == PATHFOLD_OK && split ? 1 : 0;
}

pathfold_status pathfold_denoiser_clear(pathfold_denoiser *denoiser) {
    return guarded([&] {
        const Using at(denoiser);
        at->frame.clear();
        at->denoiser.forget();
    });
}

pathfold_status pathfold_denoiser_set_number(pathfold_denoiser *denoiser, const char *name, double value) {
    return guarded([&] { Using(denoiser)->settings.set_number(given_text(name, "name"), value); });
}

pathfold_status pathfold_denoiser_set_leave_out(pathfold_denoiser *denoiser, const char *names) {
    return guarded(
        [&] { Using(denoiser)->settings.leave_out = parse_leave_out(given_text(names, "names")); });
}

pathfold_status pathfold_denoiser_set_progress(pathfold_denoiser *denoiser, pathfold_progress progress,
                                               void *user) {
    return guarded([&] {
        const Using at(denoiser);
        at->settings.progress = nullptr;
        if (progress != nullptr)
            at->settings.progress = [=](float done) { return progress(user, done) != 0; };
    });
}

pathfold_status pathfold_denoiser_plan(const pathfold_denoiser *denoiser, pathfold_plan *plan) {
    return guarded([&] {
        const Using at(denoiser);
        pathfold_plan &result = given(plan, "plan");
        pathfold_plan known = pathfold_plan_init();
        copy_known(result, known, "plan");
        const Plan found = at->denoiser.plan(at->frame, at->settings);
        known.size = result.size;
        known.tile_width = found.tiles[0].core.width;
        known.tile_height = found.tiles[0].core.height;
        known.tiles = int64_t(found.tiles.size());
        known.window_pixels = found.window_pixels;
        known.pixels = found.pixels;
        known.window_bytes = found.window_bytes;
        known.frame_bytes = found.frame_bytes;
        std::memcpy(&result, &known, known.size);
    });
}

pathfold_status pathfold_denoiser_run(pathfold_denoiser *denoiser) {
    return guarded([&] {
        const Using at(denoiser);
        at->report = "{}"; // where the run fails, that before says nothing of it
        at->report = at->denoiser.run(at->frame, at->settings);
    });
}

void pathfold_denoiser_cancel(pathfold_denoiser *denoiser) {
    if (denoiser != nullptr)
        denoiser->denoiser.cancel();
}

const char *pathfold_denoiser_report(const pathfold_denoiser *denoiser) {
    const char *report = "{}";
    (void)guarded([&] { report = Using(denoiser)->report.c_str(); });
    return report;
}

pathfold_status pathfold_auto_exposure(const pathfold_image *color, float *exposure) {
    return guarded([&] {
        given(exposure, "exposure");
        Frame frame;
        frame.set_input("color", &given(color, "color"));
        const ImageView &view = frame.input("color");
        view.expect_data("color");
        std::vector<uint8_t> valid(size_t(view.width()) * view.height(), 1);
        Threads threads;
        Mended mended;
        Planes planes = load_radiance(view, threads);
        sanitise_radiance(planes, "color", valid, threads, mended);
        *exposure = auto_exposure({&planes}, valid, 0.18f, threads);
    });
}

pathfold_status pathfold_gather(const pathfold_image *image, const float *logits, int size,
                                const pathfold_image *result) {
    return guarded([&] {
        const ImageView view(given(image, "image"), "image"), out(given(result, "result"), "result");
        view.expect_data("image");
        out.expect_data("result");
        given(logits, "logits");
        if (size < 1 || size > 63 || size % 2 == 0)
            fail(PATHFOLD_INVALID_ARGUMENT, "size is ", size, "; it must be odd, from 1 to 63");
        if (view.size_text() != out.size_text() || view.samples() != 1)
            fail(PATHFOLD_INVALID_ARGUMENT, "result is ", out.size_text(), "; it must be like image, ",
                 view.size_text());
        Threads threads;
        gather_image(threads, view, logits, size / 2, out);
    });
}
