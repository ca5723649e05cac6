#pragma once

#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "engine.h"
#include "manifest.h"
#include "process.h"

namespace pathfold::core {

/// A model folder: its files checked, its networks ready. Immutable, shared between denoisers.
class Model {
public:
    /// Loads a model by name or folder. `threads` 0: as many as there are processors for
    /// this process, which is also the most; `precision` "auto", "fp32" or
    /// "int8".
    Model(const std::string &name, const std::string &provider, int threads,
          const std::string &precision = "auto");

    const std::string &folder() const { return folder_; }
    const std::string &provider() const { return provider_; }
    int threads() const { return threads_; }                    ///< at most as many as there are processors
    int asked_threads() const { return asked_threads_; }        ///< 0: all
    const std::string &precision() const { return precision_; } ///< "fp32" or "int8"
    const Manifest &manifest() const { return manifest_; }
    const Graph &graph(const std::string &name) const { return manifest_.graphs.at(name); }

    /// Of a graph. Loaded anew where this process was forked from the one that loaded the model; throws
    /// invalid-model, engine where that fails.
    const Session &session(const std::string &graph) const;

private:
    using Sessions = std::map<std::string, Session>;

    Sessions load_sessions() const;

    std::string folder_, provider_;
    int asked_threads_, threads_;
    Manifest manifest_;
    std::string precision_, absolute_; ///< the folder wherever the process has gone since
    mutable std::mutex mutex_;         ///< of loading anew
    mutable Process process_;          ///< that loaded the sessions
    mutable Sessions sessions_;
};

/// The folder of a model of that name; see pathfold_find_model.
std::string find_model(const std::string &name, const std::vector<std::string> &folders);

} // namespace pathfold::core
