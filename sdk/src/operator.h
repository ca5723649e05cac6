#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "engine.h"
#include "image.h"
#include "parallel.h"
#include "shape.h"
#include "tiles.h"

namespace pathfold::core {

/// What a manifest says of its way to make pixels out of what networks predict: an operator and its options.
struct Reconstruction {
    std::string name;   ///< of the operator
    int size = 0;       ///< edge of a kernel in pixels
    bool trust = false; ///< whether networks predict a shift per pixel too, after the kernels' logits
    bool clean = false; ///< whether they predict how to clean what radiance is divided by
};

/// Floats that may be read past the end of a prediction.
constexpr size_t prediction_slack = 64;

/// What a graph predicts for a window; keeps its memory.
class Prediction {
public:
    /// Memory for outputs of these shapes, valid until the next call.
    std::vector<Tensor> reset(const std::map<std::string, Shape> &outputs, const Rect &window,
                              int64_t samples);

    const float *at(const std::string &output) const { return memory_.data() + offsets_.at(output); }

private:
    std::map<std::string, size_t> offsets_;
    std::vector<float> memory_;
};

/// What one branch filters in a tile: planes of the whole frame, some of them divided by a factor meanwhile.
struct Source {
    struct Plane {
        const Planes *values = nullptr;
        int channel = 0;
        bool divided = false;
    };

    int width = 0, height = 0;      ///< of the frame
    const uint8_t *valid = nullptr; ///< per pixel of the frame: 0 where the beauty's radiance is not known
    const Planes *factor = nullptr; ///< of the frame
    Planes cleaned;                 ///< of the window: instead of the factor, where there is one
    std::vector<Plane> planes;
    Tile tile;

    const uint8_t *valid_row(int x, int y) const { return valid + size_t(y) * width + x; }

    /// What a plane is divided by from the frame's pixel (x, y) on; null: nothing.
    const float *factor_row(size_t plane, int x, int y) const;

    /// The values of a plane, divided, of `count` pixels from the frame's pixel (x, y) on.
    void copy_row(size_t plane, int x, int y, int count, float *to) const;
};

/// A way to make pixels out of what networks predict, with its working memory.
class Operator {
public:
    virtual ~Operator() = default;

    /// What the graph of a branch must give.
    virtual std::map<std::string, Shape> outputs() const = 0;

    /// How many pixels away a value can be that a result depends on.
    virtual int reach() const = 0;

    /// By how many pixels windows must overlap at least: as far as results depend on what is predicted.
    virtual int least_overlap() const = 0;

    /// Where windows must start: at multiples of this.
    virtual int alignment() const = 0;

    /// Pixels of a window that is large enough: larger ones are not faster.
    virtual int64_t window_pixels() const = 0;

    /// What it holds for each pixel of a window, where that is more than what a network holds for its inputs.
    virtual int64_t floats_per_pixel() const = 0;

    /// Filters the source's planes: result[plane][y][x] of the tile's core. It may clean the factor first.
    virtual void apply(Threads &threads, const Prediction &prediction, Source &source, float *result) = 0;
};

/// A kind of operator, as manifests name it.
struct OperatorKind {
    std::set<std::string> options; ///< of Reconstruction, that it must or can be given
    bool cleans;                   ///< whether it can clean the factor
    std::unique_ptr<Operator> (*make)(const Reconstruction &);
};

/// All there are, by name. The one place that knows them; each is a file operator_NAME.cpp.
const std::map<std::string, OperatorKind> &operators();

std::unique_ptr<Operator> make_operator(const Reconstruction &options);

std::unique_ptr<Operator> make_gather(const Reconstruction &options);
std::unique_ptr<Operator> make_pyramid(const Reconstruction &options);

} // namespace pathfold::core
