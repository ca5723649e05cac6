#include "model.h"

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>

#include <dlfcn.h>

#include "error.h"
#include "machine.h"
#include "onnx_check.h"
#include "sha256.h"

namespace pathfold::core {
namespace {

namespace fs = std::filesystem;

constexpr uintmax_t max_file_bytes = uintmax_t(1) << 30;

std::string read_file(const fs::path &path) {
    std::error_code error;
    const uintmax_t size = fs::file_size(path, error);
    if (error)
        fail(PATHFOLD_INVALID_MODEL, "has no readable file ", path.string(), ": ", error.message());
    if (size > max_file_bytes)
        fail(PATHFOLD_INVALID_MODEL, path.string(), " has ", size, " bytes; at most ", max_file_bytes,
             " are read");
    std::ifstream file(path, std::ios::binary);
    std::string bytes(size, '\0');
    if (!file.read(bytes.data(), std::streamsize(size)))
        fail(PATHFOLD_INVALID_MODEL, path.string(), " cannot be read");
    return bytes;
}

/// A manifest's shape fits a graph's: same rank, same fixed sizes, and dynamic where the manifest says so.
/// An exporter may leave a size of an output open that the manifest knows.
bool fits(const Shape &said, const Port &port, bool is_output) {
    if (!port.float32 || port.shape.size() != said.size())
        return false;
    for (size_t i = 0; i < said.size(); ++i) {
        const bool open = is_output && port.shape[i] < 0;
        if (port.shape[i] != said[i].size && !open)
            return false;
    }
    return true;
}

std::string port_text(const Port &port) {
    std::string sizes;
    for (int64_t size : port.shape)
        sizes += (sizes.empty() ? "" : ", ") + (size < 0 ? "?" : std::to_string(size));
    return text(port.float32 ? "float32 [" : "not float32 [", sizes, "]");
}

void compare_port(const std::string &file, const std::string &name, const Shape &said,
                  const std::vector<Port> &ports, bool is_output) {
    const char *kind = is_output ? "output " : "input ";
    const auto found =
        std::find_if(ports.begin(), ports.end(), [&](const Port &port) { return port.name == name; });
    if (found == ports.end())
        fail(PATHFOLD_INVALID_MODEL, "the manifest lies about its graph: ", file, " has no ", kind, name);
    if (!fits(said, *found, is_output))
        fail(PATHFOLD_INVALID_MODEL, "the manifest lies about its graph: it says ", kind, name,
             " is float32 ", shape_text(said), ", but in ", file, " it is ", port_text(*found));
}

void compare_with_graph(const Graph &graph, const Session &session) {
    for (const auto &[name, shape] : graph.inputs)
        compare_port(graph.file, name, shape, session.inputs(), false);
    for (const Port &port : session.inputs())
        if (graph.inputs.count(port.name) == 0)
            fail(PATHFOLD_INVALID_MODEL, "the manifest lies about its graph: ", graph.file, " has the input ",
                 port.name, ", which the manifest does not list");
    for (const auto &[name, shape] : graph.outputs)
        compare_port(graph.file, name, shape, session.outputs(), true);
}

Session load_graph(const fs::path &folder, const Graph &graph, const std::string &provider, int threads) {
    const std::string bytes = read_file(folder / graph.file);
    if (const std::string hash = sha256(bytes.data(), bytes.size()); hash != graph.sha256)
        fail(PATHFOLD_INVALID_MODEL, graph.file,
             " is not the file that the manifest describes: its sha256 is ", hash, ", the manifest says ",
             graph.sha256, "; download or export the model again");
    check_onnx(bytes.data(), bytes.size(), graph.file);
    Session session(bytes.data(), bytes.size(), graph.file, provider, threads);
    compare_with_graph(graph, session);
    return session;
}

/// What "auto" stands for, and whether the model has what was asked for.
std::string choose_precision(const std::string &asked, const Manifest &manifest,
                             const std::string &provider) {
    const bool has_int8 = manifest.variants.count("int8") > 0;
    if (asked == "auto")
        return has_int8 && is_faster_in_int8(provider) ? "int8" : "fp32";
    if (asked == "int8" && !has_int8)
        fail(PATHFOLD_UNSUPPORTED, "the model ", manifest.name,
             " has no int8 variant; give precision fp32 or auto, or export it anew with a data set to "
             "calibrate on (pathfold-train export --data)");
    if (asked != "int8" && asked != "fp32")
        fail(PATHFOLD_INVALID_ARGUMENT, "precision is \"", asked, "\"; it must be auto, fp32 or int8");
    return asked;
}

/// share/pathfold/models beside the lib folder that this library is in; empty where that is unknown.
std::string installed_models() {
    Dl_info info{};
    if (dladdr(reinterpret_cast<void *>(&installed_models), &info) == 0 || info.dli_fname == nullptr)
        return {};
    const fs::path library = fs::absolute(info.dli_fname);
    for (fs::path folder = library.parent_path(); folder.has_relative_path(); folder = folder.parent_path())
        if (fs::path models = folder / "share" / "pathfold" / "models"; fs::is_directory(models))
            return models.string();
    return {};
}

std::vector<std::string> models_in(const std::vector<std::string> &folders) {
    std::vector<std::string> names;
    std::error_code error;
    for (const std::string &folder : folders)
        for (const fs::directory_entry &entry : fs::directory_iterator(folder, error))
            if (fs::exists(entry.path() / "manifest.json", error))
                names.push_back(entry.path().filename().string());
    std::sort(names.begin(), names.end());
    names.erase(std::unique(names.begin(), names.end()), names.end());
    return names;
}

} // namespace

std::string find_model(const std::string &name, const std::vector<std::string> &folders) {
    std::error_code error;
    if (fs::is_directory(name, error))
        return name;
    std::vector<std::string> places;
    if (const char *variable = std::getenv("PATHFOLD_MODEL_PATH")) {
        std::istringstream parts(variable);
        for (std::string part; std::getline(parts, part, ':');)
            places.push_back(part);
    }
    places.insert(places.end(), folders.begin(), folders.end());
    if (const std::string installed = installed_models(); !installed.empty())
        places.push_back(installed);
    const std::string last = name.substr(0, name.find_last_not_of('/') + 1); // a shell completes names so
    const bool plain = !last.empty() && last.find('/') == std::string::npos && last[0] != '.';
    for (const std::string &place : places)
        if (fs::path folder = fs::path(place) / last; plain && fs::exists(folder / "manifest.json", error))
            return folder.string();
    fail(PATHFOLD_NOT_FOUND, "there is no model \"", name, "\"; models found: ", list(models_in(places)),
         " (looked in ", list(places), "); give one of these, a model folder, or set PATHFOLD_MODEL_PATH");
}

Model::Model(const std::string &name, const std::string &provider, int threads,
             const std::string &precision) try
    : folder_(find_model(name, {})), provider_(provider), asked_threads_(threads),
      threads_(threads > 0 ? std::min(threads, available_processors()) : available_processors()),
      manifest_(Manifest::parse(read_file(fs::path(folder_) / "manifest.json"))),
      precision_(choose_precision(precision, manifest_, provider_)), absolute_(fs::absolute(folder_)),
      sessions_(load_sessions()) {
} catch (const Error &error) {
    if (error.status() != PATHFOLD_INVALID_MODEL)
        throw;
    fail(PATHFOLD_INVALID_MODEL, "the model ", name, ": ", error.what()); // one of several may be meant
}

Model::Sessions Model::load_sessions() const {
    Sessions sessions;
    const Variant own = precision_ == "fp32" ? Variant() : manifest_.variants.at(precision_);
    for (const auto &[key, graph] : manifest_.graphs)
        sessions.emplace(
            key, load_graph(absolute_, own.count(key) > 0 ? own.at(key) : graph, provider_, threads_));
    return sessions;
}

const Session &Model::session(const std::string &graph) const {
    if (!process_.is_this()) {
        const std::lock_guard<std::mutex> lock(mutex_);
        if (!process_.is_this()) {
            try {
                sessions_ = load_sessions();
            } catch (const Error &error) {
                fail(error.status(), "the model ", manifest_.name,
                     ", loaded before this process was forked, ",
                     "cannot be loaded anew here: ", error.what());
            }
            process_.become_this();
        }
    }
    return sessions_.at(graph);
}

} // namespace pathfold::core
