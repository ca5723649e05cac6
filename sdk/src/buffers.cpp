#include "buffers.h"

namespace pathfold::core {

const std::vector<BufferKind> &buffer_kinds() {
    static const std::vector<BufferKind> kinds = {
        {"color", 3, 0},
        {"alpha", 1, 0},
        {"diffuse", 3, 0},
        {"specular", 3, 0},
        {"diffuse.albedo", 3, 0},
        {"albedo", 3, 0},
        {"normal", 3, 0},
        {"depth", 1, 0},
        {"variance", 3, 0},
        {"diffuse.variance", 3, 0},
        {"specular.variance", 3, 0},
        {"samples.descriptor", pathfold_descriptor_layout(PATHFOLD_MAX_VERTICES).channels, 1},
        {"samples.density", 1, 1},
        {"samples.valid", 1, 1},
    };
    return kinds;
}

const BufferKind *find_buffer(const std::string &name) {
    for (const BufferKind &kind : buffer_kinds())
        if (name == kind.name)
            return &kind;
    return nullptr;
}

std::string buffer_names() {
    std::string names;
    for (const BufferKind &kind : buffer_kinds())
        names += (names.empty() ? "" : ", ") + std::string(kind.name);
    return names;
}

const std::vector<Guide> &guides() {
    static const std::vector<Guide> all = {
        {"albedo", {{0, 1}, Missing::mean, false}, true},
        {"normal", {{-1, 1}, Missing::zero, false}, true},
        {"depth", {{0, farthest_depth}, Missing::zero, true}, true},
        {"diffuse.albedo", {{0, 1}, Missing::mean, false}, false}, // where the frame is split, it is there
    };
    return all;
}

const Guide *find_guide(const std::string &name) {
    for (const Guide &guide : guides())
        if (name == guide.name)
            return &guide;
    return nullptr;
}

Meaning meaning_of(const std::string &buffer) {
    if (const Guide *guide = find_guide(buffer))
        return guide->meaning;
    if (buffer == "alpha")
        return {{0, 1}, Missing::mean, false};
    return {{0, largest_variance}, Missing::most, true};
}

} // namespace pathfold::core
