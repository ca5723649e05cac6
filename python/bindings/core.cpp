// pathfold._core: NumPy arrays in, NumPy arrays out, the GIL released in between. No logic of its own.
#include <algorithm>
#include <atomic>
#include <exception>
#include <map>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <unistd.h>

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include "descriptor.h"
#include "interpreter.h"
#include "pathfold/pathfold.hpp"
#include "watched_run.h"

namespace py = pybind11;

namespace {

py::object parse_json(const std::string &text) { return py::module_::import("json").attr("loads")(text); }

[[noreturn]] void invalid(const std::string &message) {
    throw pathfold::Error(PATHFOLD_INVALID_ARGUMENT, message);
}

pathfold_format format_of(const py::array &array, const std::string &name) {
    if (array.dtype().equal(py::dtype("float32")))
        return PATHFOLD_FLOAT32;
    if (array.dtype().equal(py::dtype("float16")))
        return PATHFOLD_FLOAT16;
    invalid(name + ": dtype is " + std::string(py::str(array.dtype())) +
            "; it must be float32 or float16 in native byte order (use .astype(\"float32\"))");
}

/// A view of an array's memory: H x W x C, or S x H x W x C for samples; H x W means one channel.
pathfold_image view_of(const py::array &array, const std::string &name) {
    const bool samples = name.rfind("samples.", 0) == 0;
    const py::ssize_t rank = array.ndim(), most = samples ? 4 : 3;
    if (rank != most && rank != most - 1)
        invalid(name + ": the array has " + std::to_string(rank) + " axes; it must be " +
                (samples ? "samples x height x width x channels" : "height x width x channels"));
    const py::ssize_t y = samples ? 1 : 0, x = y + 1, c = y + 2;
    pathfold_image image{};
    image.data = const_cast<void *>(array.data());
    image.format = format_of(array, name);
    image.samples = samples ? array.shape(0) : 1;
    image.sample_stride = samples ? array.strides(0) : 0;
    image.height = array.shape(y);
    image.row_stride = array.strides(y);
    image.width = array.shape(x);
    image.pixel_stride = array.strides(x);
    image.channels = rank > c ? array.shape(c) : 1;
    image.channel_stride = rank > c ? array.strides(c) : array.itemsize();
    return image;
}

py::array array_of(const py::handle &object, const std::string &name) {
    if (py::isinstance<py::array>(object))
        return py::reinterpret_borrow<py::array>(object);
    if (py::isinstance<py::buffer>(object))
        return py::array(py::reinterpret_borrow<py::object>(object));
    invalid(name + ": it is a " + std::string(py::str(py::type::of(object).attr("__name__"))) +
            "; give a NumPy array or another buffer");
}

using Arrays = std::map<std::string, py::object>;
using Layers = std::map<std::string, Arrays>;

struct Plan : pathfold_plan {
    int64_t result_bytes; ///< of the arrays that a run returns
};

/// One model applied to frames; Python threads that share one take turns.
class Denoiser {
public:
    Denoiser(const pathfold::Model &model, int memory_mb, int tile, const std::string &leave_out)
        : denoiser_(model) {
        denoiser_.set("memory_mb", memory_mb).set("tile", tile).leave_out(leave_out);
    }

    py::tuple run(const Arrays &buffers, const std::optional<Layers> &layers,
                  const std::optional<double> &exposure, const py::object &progress, int samples_per_pixel) {
        if (exposure && !(*exposure > 0))
            invalid("exposure is " + std::to_string(*exposure) + "; it must be > 0, or None");
        Call call;
        const Turn turn(*this, call);
        denoiser_.set("exposure", exposure.value_or(0));
        std::vector<py::array> kept;
        py::dict result = set_frame(buffers, layers, samples_per_pixel, kept);
        const std::string report = run_watched(call, denoiser_, progress);
        take_away();
        return py::make_tuple(result, parse_json(report));
    }

    /// What `run` would come to.
    Plan plan(const Arrays &buffers, const std::optional<Layers> &layers, int samples_per_pixel) {
        Call call;
        const Turn turn(*this, call);
        std::vector<py::array> kept;
        const py::dict result = set_frame(buffers, layers, samples_per_pixel, kept);
        Plan plan{denoiser_.plan(), 0};
        take_away();
        for (const auto &[name, array] : result)
            plan.result_bytes += py::reinterpret_borrow<py::array>(array).nbytes();
        return plan;
    }

private:
    /// One thread's turn at the denoiser; a run from within its own progress callback would wait for itself.
    class Turn {
    public:
        Turn(Denoiser &denoiser, Call &call)
            : denoiser_(denoiser), call_(call), lock_(denoiser.turn_, std::defer_lock) {
            if (denoiser.owner_ == std::this_thread::get_id())
                invalid("this denoiser is running, and its progress callback asks it to run again; use "
                        "another Denoiser there");
            if (denoiser.owner_ != std::thread::id() && denoiser.process_ != getpid())
                invalid("this denoiser was running when the process was forked; make another Denoiser here");
            call.released([&] {
                while (!lock_.try_lock_for(Call::interval)) {
                    if (call.is_ending())
                        return;
                    call.taken(check_signals);
                }
            });
            denoiser.owner_ = std::this_thread::get_id();
            denoiser.process_ = getpid();
            call.let_go = [this] { end(); };
        }
        ~Turn() {
            call_.let_go = nullptr;
            end();
        }
        Turn(const Turn &) = delete;

    private:
        void end() {
            denoiser_.owner_ = std::thread::id();
            lock_.unlock();
        }

        Denoiser &denoiser_;
        Call &call_;
        std::unique_lock<std::timed_mutex> lock_;
    };

    /// Sets inputs and outputs; returns the latter. `kept` must live until the run is over.
    py::dict set_frame(const Arrays &buffers, const std::optional<Layers> &layers, int samples_per_pixel,
                       std::vector<py::array> &kept) {
        take_away(); // what a frame that failed left
        denoiser_.set("samples_per_pixel", samples_per_pixel);
        const auto keep = [&](const py::object &object, const std::string &name) {
            kept.push_back(array_of(object, name));
            return view_of(kept.back(), name);
        };
        py::dict result;
        for (const auto &[name, object] : buffers) {
            denoiser_.input(name, keep(object, name));
            inputs_.insert(name);
        }
        for (const auto &[layer, parts] : layers.value_or(Layers()))
            set_layer(layer, parts, keep, result);
        set_outputs(buffers, keep, result);
        return result;
    }

    /// Takes the frame away, but keeps the working memory for the next one.
    void take_away() {
        pathfold_denoiser *at = denoiser_.get();
        for (const std::string &name : inputs_)
            pathfold::check(pathfold_denoiser_set_input(at, name.c_str(), nullptr));
        for (const std::string &name : outputs_)
            pathfold::check(pathfold_denoiser_set_output(at, name.c_str(), nullptr));
        for (const auto &[layer, part] : layers_) {
            pathfold::check(pathfold_denoiser_set_layer_output(at, layer.c_str(), nullptr));
            pathfold::check(pathfold_denoiser_set_layer(at, layer.c_str(), part.c_str(), nullptr));
        }
        inputs_.clear();
        outputs_.clear();
        layers_.clear();
    }

    template <typename Keep>
    void set_layer(const std::string &layer, const Arrays &parts, const Keep &keep, py::dict &result) {
        pathfold_image view{};
        for (const auto &[part, object] : parts) {
            denoiser_.layer(layer, part, view = keep(object, layer + "." + part));
            layers_.emplace(layer, part);
        }
        if (parts.empty())
            invalid("the layer " + layer + " is empty; give color, or diffuse and specular");
        result[py::str(layer)] = make_output(view);
        denoiser_.layer_output(layer, keep(result[py::str(layer)], layer));
    }

    template <typename Keep>
    void set_outputs(const Arrays &buffers, const Keep &keep, py::dict &result) {
        std::vector<std::string> names;
        if (buffers.count("color") + buffers.count("diffuse") > 0)
            names.push_back("color");
        if (buffers.count("alpha") > 0)
            names.push_back("alpha");
        if (denoiser_.is_split())
            names.insert(names.end(), {"diffuse", "specular"});
        for (const std::string &name : names) {
            const std::string like = buffers.count(name) > 0 ? name : "diffuse";
            result[py::str(name)] = make_output(keep(buffers.at(like), like));
            denoiser_.output(name, keep(result[py::str(name)], name));
            outputs_.insert(name);
        }
    }

    static py::array_t<float> make_output(const pathfold_image &like) {
        return py::array_t<float>(std::vector<py::ssize_t>{like.height, like.width, like.channels});
    }

    pathfold::Denoiser denoiser_;
    std::set<std::string> inputs_, outputs_;               // of the frame that is set
    std::set<std::pair<std::string, std::string>> layers_; // likewise, and their parts
    std::timed_mutex turn_;
    std::atomic<std::thread::id> owner_; // whose turn it is
    std::atomic<pid_t> process_{0};      // in which process
};

float auto_exposure(const py::array &color) {
    const pathfold_image view = view_of(color, "color");
    float exposure = 0;
    Call call;
    call.released([&] { pathfold::check(pathfold_auto_exposure(&view, &exposure)); });
    return exposure;
}

py::array_t<float> gather(const py::array &image, const py::array_t<float, py::array::c_style> &logits) {
    const pathfold_image view = view_of(image, "image");
    if (logits.ndim() != 3 || logits.shape(1) != view.height || logits.shape(2) != view.width)
        invalid("logits must be [size * size, height, width] of the image");
    int size = 1;
    while (size * size < logits.shape(0))
        size += 2;
    if (size * size != logits.shape(0))
        invalid("logits has " + std::to_string(logits.shape(0)) +
                " taps; it must be the square of an odd number");
    py::array_t<float> result(std::vector<py::ssize_t>{view.height, view.width, view.channels});
    const pathfold_image output = view_of(result, "result");
    Call call;
    call.released([&] { pathfold::check(pathfold_gather(&view, logits.data(), size, &output)); });
    return result;
}

/// PathfoldError, with the status name as its attribute `code`.
py::object error_type;

void translate(std::exception_ptr pointer) {
    try {
        if (pointer)
            std::rethrow_exception(pointer);
    } catch (const pathfold::Error &error) {
        py::object instance = error_type(error.what());
        instance.attr("code") = error.code();
        PyErr_SetObject(error_type.ptr(), instance.ptr());
    }
}

pathfold::Model load_model(const std::string &folder, const std::string &provider, int threads,
                           const std::string &precision) {
    Call call;
    return call.released([&] { return pathfold::Model(folder, {provider, precision, threads}); });
}

auto manifest_entry(const char *key) {
    return [key](const pathfold::Model &model) { return py::object(parse_json(model.manifest())[key]); };
}

} // namespace

PYBIND11_MODULE(_core, module) {
    module.doc() = "The C++ denoiser. Use pathfold.denoise and pathfold.Denoiser.";
    const char *error_doc =
        "A call that failed; `code` is one of invalid-argument, not-found, invalid-model, "
        "engine, unsupported, out-of-memory, cancelled, internal.";
    error_type = py::reinterpret_steal<py::object>(
        PyErr_NewExceptionWithDoc("pathfold._core.PathfoldError", error_doc, PyExc_RuntimeError, nullptr));
    error_type.inc_ref(); // lives as long as the process: exceptions may outlast the module
    module.attr("PathfoldError") = error_type;
    py::register_exception_translator(translate);

    py::class_<pathfold::Model>(module, "Model", "A model folder, checked and loaded. Immutable.")
        .def(py::init(&load_model), py::arg("folder"), py::kw_only(), py::arg("provider") = "cpu",
             py::arg("threads") = 0, py::arg("precision") = "auto",
             "Loads a model folder (or a model by name). provider: \"cpu\", \"cuda\", ...; threads: 0 for "
             "all; precision: \"auto\", \"fp32\" or \"int8\", see pathfold.h.")
        .def_property_readonly("manifest", [](const pathfold::Model &m) { return parse_json(m.manifest()); })
        .def_property_readonly("name", manifest_entry("name"))
        .def_property_readonly("requires", manifest_entry("requires"))
        .def_property_readonly("uses", manifest_entry("uses"))
        .def_property_readonly("folder", &pathfold::Model::folder)
        .def_property_readonly("precision", &pathfold::Model::precision);

    py::class_<Plan>(module, "Plan", "What a run comes to; see pathfold_plan in pathfold.h.")
        .def_readonly("tile_width", &Plan::tile_width)
        .def_readonly("tile_height", &Plan::tile_height)
        .def_readonly("tiles", &Plan::tiles)
        .def_readonly("window_pixels", &Plan::window_pixels)
        .def_readonly("pixels", &Plan::pixels)
        .def_readonly("window_bytes", &Plan::window_bytes)
        .def_readonly("frame_bytes", &Plan::frame_bytes)
        .def_readonly("result_bytes", &Plan::result_bytes);

    py::class_<Denoiser>(module, "Denoiser", "One model applied to frames; keeps its working memory.")
        .def(py::init<const pathfold::Model &, int, int, const std::string &>(), py::arg("model"),
             py::kw_only(), py::arg("memory_mb") = 0, py::arg("tile") = 0, py::arg("leave_out") = "all",
             "memory_mb bounds a tile's working memory and tile is its edge in pixels, 0: chosen. "
             "leave_out: \"all\", \"none\" or names, see pathfold.h.")
        .def("run", &Denoiser::run, py::arg("buffers"), py::kw_only(), py::arg("layers") = py::none(),
             py::arg("exposure") = py::none(), py::arg("progress") = py::none(),
             py::arg("samples_per_pixel") = 0,
             "Denoises one frame. buffers: name to array, height x width x channels (samples in front for "
             "samples.*), float32 or float16, any strides, not copied. layers: name to {\"color\": array} or "
             "{\"diffuse\": array, \"specular\": array}. progress is called with the part done and returns "
             "False, 0 or the like to cancel, None to go on. Returns (name to float32 array, report).")
        .def("plan", &Denoiser::plan, py::arg("buffers"), py::kw_only(), py::arg("layers") = py::none(),
             py::arg("samples_per_pixel") = 0, "What a run of these would come to, by their sizes.");

    bind_descriptor(module);
    watch_interpreter();
    module.def("version", &pathfold::version, "The version of the SDK.");
    module.def("set_onnxruntime", &pathfold::set_onnxruntime, py::arg("path"),
               "Names the onnxruntime library to load, before the first model.");
    module.def(
        "find_model", &pathfold::find_model, py::arg("name"),
        py::arg("extra_dirs") = std::vector<std::string>(),
        "The folder of a model: an existing folder, or searched in PATHFOLD_MODEL_PATH and extra_dirs.");
    module.def("auto_exposure", &auto_exposure, py::arg("color"),
               "The exposure that a run would choose for a height x width x 3 image.");
    module.def("gather", &gather, py::arg("image"), py::arg("logits"),
               "Applies kernels, softmax(logits) with logits [size * size, height, width], to an image.");
}
