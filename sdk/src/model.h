#pragma once

#include <map>
#include <memory>
#include <string>
#include <vector>

#include "engine.h"
#include "manifest.h"

namespace pathfold::core {

/// A model folder: its files checked, its networks ready. Immutable, shared between denoisers.
class Model {
public:
    /// Loads a model by name or folder. `threads` 0: all of the machine's; `precision` "auto", "fp32" or
    /// "int8".
    Model(const std::string &name, const std::string &provider, int threads,
          const std::string &precision = "auto");

    const std::string &folder() const { return folder_; }
    const std::string &provider() const { return provider_; }
    int threads() const { return threads_; }
    const std::string &precision() const { return precision_; } ///< "fp32" or "int8"
    const Manifest &manifest() const { return manifest_; }
    const Graph &graph(const std::string &name) const { return manifest_.graphs.at(name); }
    const Session &session(const std::string &graph) const { return sessions_.at(graph); }

private:
    std::string folder_, provider_;
    int threads_;
    Manifest manifest_;
    std::string precision_;
    std::map<std::string, Session> sessions_;
};

/// The folder of a model of that name; see pathfold_find_model.
std::string find_model(const std::string &name, const std::vector<std::string> &folders);

} // namespace pathfold::core
