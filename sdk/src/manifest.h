#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "operator.h"
#include "shape.h"

namespace pathfold::core {

/// A network: its file and what it says of its own inputs and outputs.
struct Graph {
    std::string file, sha256;
    std::map<std::string, Shape> inputs, outputs;
};

/// Graphs that stand in for those of the same name, with the same inputs and outputs.
using Variant = std::map<std::string, Graph>;

/// One set of kernels and the radiance that it filters.
struct Branch {
    std::string name, graph;
    std::string radiance;      ///< "color", "diffuse" or "specular"
    std::string demodulate_by; ///< buffer that radiance is divided by before filtering; empty: none
    float epsilon = 0;         ///< added to that buffer
    bool clean = false;        ///< a predicted pyramid cleans that buffer before it divides and multiplies
    bool unsplit = false;      ///< takes color where a frame is not split; its kernels filter alpha too
};

/// A model folder's manifest.json, validated. `text` is the file as it stands.
struct Manifest {
    std::string name, description, license, text;
    std::vector<std::string> requires_, uses;
    std::map<std::string, Graph> graphs;     ///< of branches, and "embedding" where there is one; float32
    std::map<std::string, Variant> variants; ///< by their precision, which is "int8"
    int64_t embedding_channels = 0;          ///< of what that graph makes of samples; 0: there is none
    Reconstruction reconstruction;
    std::vector<Branch> branches;
    float exposure_key = 0.18f;
    int tile_alignment = 1, tile_overlap = 0;
    int64_t min_samples = 1, max_samples = 1;
    int64_t embedded_samples = 1 << 30; ///< the most samples of a pixel that the graph "embedding" is to see
    int64_t without_paths = 0; ///< samples per pixel from which on it does as well without paths; 0: unknown

    const Branch &unsplit_branch() const;
    bool reads(const std::string &buffer) const; ///< whether the model requires or can use it

    /// Throws invalid-model (unsupported for a newer format), naming the key, what it is, what it must be.
    static Manifest parse(const std::string &text);
};

/// The shape that a graph input of that reserved name has, empty where the name is not reserved.
Shape input_shape(const std::string &name);

/// The shape of the output of the graph "embedding" and of the input of that name.
Shape embedding_shape(int64_t channels);

} // namespace pathfold::core
