#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "pool.h"
#include "stop.h"

namespace pathfold::core {

/// A tensor in the caller's memory: row-major float32.
struct Tensor {
    std::string name;
    std::vector<int64_t> shape;
    float *data = nullptr;
};

/// A graph's input or output as the graph itself declares it; -1 is a dynamic size.
struct Port {
    std::string name;
    std::vector<int64_t> shape;
    bool float32 = true;
};

/// Names the onnxruntime library to load; see pathfold_set_onnxruntime.
void set_onnxruntime(const std::string &path);

/// Whether quantised networks run faster there than float32 ones. Told by the processor's instructions, not
/// by a trial, so that every run on it gives the same picture. Measured by benchmarks/int8.py on x86 with
/// VNNI; without, onnxruntime adds products of bytes in 16 bits, which saturate. ARM's dot products: not
/// measured.
bool is_faster_in_int8(const std::string &provider);

/// A network made ready to run, by onnxruntime loaded at run time. Immutable: threads may share it. In the
/// child of a fork it lacks its threads: it can only be destroyed, which gives nothing back there.
class Session {
public:
    /// `name` is what messages call the graph. Throws engine, not-found (no library), unsupported (provider).
    Session(const void *model, size_t size, const std::string &name, const std::string &provider,
            int threads);
    ~Session();
    Session(Session &&) noexcept;

    const std::vector<Port> &inputs() const { return inputs_; }
    const std::vector<Port> &outputs() const { return outputs_; }

    /// Runs the graph into `outputs`, whose memory the caller gives; what it works in is the pool's. Throws
    /// engine, out-of-memory where it takes more than the pool's bound, cancelled.
    void run(const std::vector<Tensor> &inputs, const std::vector<Tensor> &outputs, Stop &stop,
             Pool &pool) const;

private:
    struct Handles;
    std::unique_ptr<Handles> handles_;
    std::string name_;
    std::vector<Port> inputs_, outputs_;
};

} // namespace pathfold::core
