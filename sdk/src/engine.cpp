#include "engine.h"

#include <algorithm>
#include <cctype>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <iostream>
#include <mutex>

#include <dlfcn.h>
#if defined(__aarch64__) && defined(__linux__)
#include <asm/hwcap.h>
#include <sys/auxv.h>
#endif
#include <onnxruntime_c_api.h>

#include "error.h"
#include "process.h"

namespace pathfold::core {
namespace {

std::mutex library_mutex;
std::string library_path; // as set_onnxruntime was told, then what was loaded
bool library_loaded = false;

/// The loaded library and its one environment; lives as long as the process, as onnxruntime wants it.
struct Library {
    std::string path;
    const OrtApi *api = nullptr;
    OrtEnv *env = nullptr;
};

void check(const OrtApi *api, OrtStatus *status, const std::string &what) {
    if (status == nullptr)
        return;
    const std::string message = api->GetErrorMessage(status);
    api->ReleaseStatus(status);
    fail(PATHFOLD_ENGINE, what, ": onnxruntime says: ", message);
}

/// Failures come back as statuses; onnxruntime's own lines on stderr would say them twice.
void ORT_API_CALL drop_log(void *, OrtLoggingLevel, const char *, const char *, const char *, const char *) {}

void *open_library(std::string &path) {
    std::vector<std::string> places;
    const char *variable = std::getenv("PATHFOLD_ONNXRUNTIME");
    if (!path.empty())
        places = {path};
    else if (variable != nullptr && *variable != '\0')
        places = {variable};
    else
        places = {"libonnxruntime.so.1", "libonnxruntime.so", "libonnxruntime.dylib"};
    std::string reasons;
    for (const std::string &place : places) {
        if (void *handle = dlopen(place.c_str(), RTLD_NOW | RTLD_LOCAL)) {
            path = place;
            return handle;
        }
        reasons += (reasons.empty() ? "" : "; ") + std::string(dlerror());
    }
    fail(PATHFOLD_NOT_FOUND, "onnxruntime cannot be loaded (", reasons,
         "); install it (pip install onnxruntime) and name its library in PATHFOLD_ONNXRUNTIME");
}

/// How onnxruntime sees the pools of those that run; lives as long as its environment.
struct PoolAllocator : OrtAllocator {
    OrtMemoryInfo *info = nullptr;

    explicit PoolAllocator(OrtMemoryInfo *of) : OrtAllocator(), info(of) {
        version = ORT_API_VERSION;
        Alloc = Reserve = [](OrtAllocator *, size_t bytes) { return Pool::allocate(bytes); };
        Free = [](OrtAllocator *, void *memory) { Pool::free(memory); };
        Info = [](const OrtAllocator *self) -> const OrtMemoryInfo * {
            return static_cast<const PoolAllocator *>(self)->info;
        };
    }
};

void register_allocator(const OrtApi *api, OrtEnv *env) {
    OrtMemoryInfo *info = nullptr;
    check(api, api->CreateCpuMemoryInfo(OrtDeviceAllocator, OrtMemTypeDefault, &info), "describing memory");
    check(api, api->RegisterAllocator(env, new PoolAllocator(info)), "starting onnxruntime");
}

/// Lets the child of a fork exit: onnxruntime, which keeps a thread of its own, would wait for it there. What
/// was registered with atexit before onnxruntime was loaded is skipped in such a child.
void skip_exit_of_children() {
#ifdef __GLIBC__
    static const Process loader;
    on_exit(
        [](int status, void *) {
            if (loader.is_this())
                return;
            std::cout.flush();
            std::fflush(nullptr);
            _exit(status);
        },
        nullptr);
#endif
}

Library load_library() {
    Library library{library_path};
    void *handle = open_library(library.path);
    using GetBase = const OrtApiBase *(ORT_API_CALL *)();
    const auto get_base = reinterpret_cast<GetBase>(dlsym(handle, "OrtGetApiBase"));
    if (get_base == nullptr)
        fail(PATHFOLD_NOT_FOUND, library.path, " is not an onnxruntime library: it has no OrtGetApiBase");
    library.api = get_base()->GetApi(ORT_API_VERSION);
    if (library.api == nullptr)
        fail(PATHFOLD_UNSUPPORTED, library.path, " is onnxruntime ", get_base()->GetVersionString(), "; 1.",
             ORT_API_VERSION, " or newer is needed");
    check(library.api,
          library.api->CreateEnvWithCustomLogger(drop_log, nullptr, ORT_LOGGING_LEVEL_FATAL, "pathfold",
                                                 &library.env),
          "starting onnxruntime");
    register_allocator(library.api, library.env);
    skip_exit_of_children();
    return library;
}

const Library &get_library() {
    static Library library;
    const std::lock_guard<std::mutex> lock(library_mutex);
    if (!library_loaded) {
        library = load_library();
        library_path = library.path;
        library_loaded = true;
    }
    return library;
}

std::string lower(std::string name) {
    for (char &letter : name)
        letter = char(std::tolower(static_cast<unsigned char>(letter)));
    return name;
}

/// onnxruntime's own spelling of each provider on offer, without the ending "ExecutionProvider".
std::vector<std::string> offered_providers(const OrtApi *api) {
    char **names = nullptr;
    int count = 0;
    check(api, api->GetAvailableProviders(&names, &count), "listing execution providers");
    std::vector<std::string> offered;
    for (int i = 0; i < count; ++i) {
        const std::string name = names[i];
        if (name != "AzureExecutionProvider") // it runs nothing here
            offered.push_back(name.substr(0, name.find("ExecutionProvider")));
    }
    check(api, api->ReleaseAvailableProviders(names, count), "listing execution providers");
    return offered;
}

void append_cuda(const OrtApi *api, OrtSessionOptions *options) {
    OrtCUDAProviderOptionsV2 *cuda = nullptr;
    check(api, api->CreateCUDAProviderOptions(&cuda), "the execution provider cuda");
    OrtStatus *status = api->SessionOptionsAppendExecutionProvider_CUDA_V2(options, cuda);
    api->ReleaseCUDAProviderOptions(cuda);
    check(api, status, "the execution provider cuda");
}

void append_provider(const Library &library, OrtSessionOptions *options, const std::string &provider) {
    if (lower(provider) == "cpu")
        return;
    const std::vector<std::string> offered = offered_providers(library.api);
    const auto found = std::find_if(offered.begin(), offered.end(),
                                    [&](const std::string &name) { return lower(name) == lower(provider); });
    if (found == offered.end()) {
        std::vector<std::string> names;
        std::transform(offered.begin(), offered.end(), std::back_inserter(names), lower);
        fail(PATHFOLD_UNSUPPORTED, "the execution provider ", provider, " is not in ", library.path,
             ", which offers: ", list(names), "; use one of these or another build of onnxruntime");
    }
    if (*found == "CUDA")
        return append_cuda(library.api, options);
    check(library.api,
          library.api->SessionOptionsAppendExecutionProvider(options, found->c_str(), nullptr, nullptr, 0),
          "the execution provider " + provider);
}

template <typename GetInfo>
Port describe(const OrtApi *api, OrtAllocator *allocator, char *name, GetInfo get_info) {
    Port port{name, {}, false};
    check(api, api->AllocatorFree(allocator, name), "reading a graph");
    OrtTypeInfo *type = nullptr;
    check(api, get_info(&type), "reading a graph");
    const OrtTensorTypeAndShapeInfo *tensor = nullptr;
    check(api, api->CastTypeInfoToTensorInfo(type, &tensor), "reading a graph");
    if (tensor != nullptr) {
        ONNXTensorElementDataType element = ONNX_TENSOR_ELEMENT_DATA_TYPE_UNDEFINED;
        size_t rank = 0;
        check(api, api->GetTensorElementType(tensor, &element), "reading a graph");
        check(api, api->GetDimensionsCount(tensor, &rank), "reading a graph");
        port.float32 = element == ONNX_TENSOR_ELEMENT_DATA_TYPE_FLOAT;
        port.shape.resize(rank);
        check(api, api->GetDimensions(tensor, port.shape.data(), rank), "reading a graph");
    }
    api->ReleaseTypeInfo(type);
    return port;
}

/// Owns the OrtValues of one run.
class Values {
public:
    explicit Values(const OrtApi *api) : api_(api) {
        check(api, api->CreateCpuMemoryInfo(OrtDeviceAllocator, OrtMemTypeDefault, &memory_),
              "describing memory");
    }
    ~Values() {
        for (OrtValue *value : values_)
            api_->ReleaseValue(value);
        api_->ReleaseMemoryInfo(memory_);
    }
    Values(const Values &) = delete;

    void add(const Tensor &tensor) {
        size_t count = 1;
        for (int64_t size : tensor.shape)
            count *= size_t(size);
        OrtValue *value = nullptr;
        check(api_,
              api_->CreateTensorWithDataAsOrtValue(memory_, tensor.data, count * sizeof(float),
                                                   tensor.shape.data(), tensor.shape.size(),
                                                   ONNX_TENSOR_ELEMENT_DATA_TYPE_FLOAT, &value),
              "the tensor " + tensor.name);
        values_.push_back(value);
    }
    OrtValue **data() { return values_.data(); }

private:
    const OrtApi *api_;
    OrtMemoryInfo *memory_ = nullptr;
    std::vector<OrtValue *> values_;
};

/// Of one run: lets another thread end it, between two of the graph's operators.
class RunOptions {
public:
    explicit RunOptions(const OrtApi *api) : api_(api) {
        check(api, api->CreateRunOptions(&options_), "run options");
    }
    ~RunOptions() { api_->ReleaseRunOptions(options_); }
    RunOptions(const RunOptions &) = delete;

    void terminate() const { api_->ReleaseStatus(api_->RunOptionsSetTerminate(options_)); }
    const OrtRunOptions *get() const { return options_; }

private:
    const OrtApi *api_;
    OrtRunOptions *options_ = nullptr;
};

} // namespace

void set_onnxruntime(const std::string &path) {
    const std::lock_guard<std::mutex> lock(library_mutex);
    if (!std::filesystem::is_regular_file(path))
        fail(PATHFOLD_NOT_FOUND, "onnxruntime: there is no file ", path);
    if (library_loaded && path != library_path)
        fail(PATHFOLD_INVALID_ARGUMENT, "onnxruntime is loaded already from ", library_path,
             "; name another library before the first model is loaded");
    library_path = path;
}

bool is_faster_in_int8(const std::string &provider) {
    if (lower(provider) != "cpu")
        return false;
#if defined(__x86_64__)
    return __builtin_cpu_supports("avx512vnni") != 0 || __builtin_cpu_supports("avxvnni") != 0;
#elif defined(__aarch64__) && defined(__linux__)
    return (getauxval(AT_HWCAP) & HWCAP_ASIMDDP) != 0;
#elif defined(__aarch64__) && defined(__APPLE__)
    return true; // every one that macOS runs on
#else
    return false;
#endif
}

struct Session::Handles {
    Process process;
    const OrtApi *api = nullptr;
    OrtSessionOptions *options = nullptr;
    OrtSession *session = nullptr;

    ~Handles() {
        if (!process.is_this())
            return; // it would wait for threads that are not here
        if (session != nullptr)
            api->ReleaseSession(session);
        if (options != nullptr)
            api->ReleaseSessionOptions(options);
    }
};

Session::Session(const void *model, size_t size, const std::string &name, const std::string &provider,
                 int threads)
    : handles_(std::make_unique<Handles>()), name_(name) {
    const Library &library = get_library();
    const OrtApi *api = handles_->api = library.api;
    check(api, api->CreateSessionOptions(&handles_->options), "session options");
    OrtSessionOptions *options = handles_->options;
    check(api, api->SetIntraOpNumThreads(options, threads), "session options");
    check(api, api->SetSessionGraphOptimizationLevel(options, ORT_ENABLE_ALL), "session options");
    check(api, api->DisableMemPattern(options), "session options"); // halves the peak at no cost in time
    // Its own arena would keep the most that it ever held, and double what it asks the system for.
    check(api, api->AddSessionConfigEntry(options, "session.use_env_allocators", "1"), "session options");
    // Else idle threads of one session spin for the processors that another one, or the SDK, works on.
    check(api, api->AddSessionConfigEntry(options, "session.force_spinning_stop", "1"), "session options");
    append_provider(library, options, provider);
    check(api, api->CreateSessionFromArray(library.env, model, size, options, &handles_->session), name);

    const OrtSession *session = handles_->session;
    OrtAllocator *allocator = nullptr;
    check(api, api->GetAllocatorWithDefaultOptions(&allocator), name);
    size_t input_count = 0, output_count = 0;
    check(api, api->SessionGetInputCount(session, &input_count), name);
    check(api, api->SessionGetOutputCount(session, &output_count), name);
    for (size_t i = 0; i < input_count; ++i) {
        char *port = nullptr;
        check(api, api->SessionGetInputName(session, i, allocator, &port), name);
        inputs_.push_back(describe(api, allocator, port, [&](OrtTypeInfo **type) {
            return api->SessionGetInputTypeInfo(session, i, type);
        }));
    }
    for (size_t i = 0; i < output_count; ++i) {
        char *port = nullptr;
        check(api, api->SessionGetOutputName(session, i, allocator, &port), name);
        outputs_.push_back(describe(api, allocator, port, [&](OrtTypeInfo **type) {
            return api->SessionGetOutputTypeInfo(session, i, type);
        }));
    }
}

Session::~Session() = default;
Session::Session(Session &&) noexcept = default;

void Session::run(const std::vector<Tensor> &inputs, const std::vector<Tensor> &outputs, Stop &stop,
                  Pool &pool) const {
    const OrtApi *api = handles_->api;
    const Pool::Use use(pool);
    const RunOptions options(api);
    const Stop::Halt halt(stop, [&] { options.terminate(); });
    Values values(api), results(api);
    std::vector<const char *> names, result_names;
    for (const Tensor &tensor : inputs) {
        values.add(tensor);
        names.push_back(tensor.name.c_str());
    }
    for (const Tensor &tensor : outputs) {
        results.add(tensor);
        result_names.push_back(tensor.name.c_str());
    }
    OrtStatus *status = api->Run(handles_->session, options.get(), names.data(), values.data(), names.size(),
                                 result_names.data(), result_names.size(), results.data());
    if (stop.asked()) {
        api->ReleaseStatus(status); // null, or that it was told to end
        stop.check();
    }
    if (status != nullptr && pool.refused()) {
        api->ReleaseStatus(status);
        fail(PATHFOLD_OUT_OF_MEMORY, "running ", name_,
             ": it takes more memory than the plan of its tiles allows, ",
             "or than there is; set memory_mb for smaller tiles, and trust the model no further");
    }
    check(api, status, "running " + name_);
}

} // namespace pathfold::core
