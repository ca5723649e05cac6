#include "buffers.h"

namespace pathfold::core {

const std::vector<BufferKind> &buffer_kinds() {
    static const std::vector<BufferKind> kinds = {
        {"color", 3, false},
        {"diffuse", 3, false},
        {"specular", 3, false},
        {"diffuse.albedo", 3, false},
        {"albedo", 3, false},
        {"normal", 3, false},
        {"depth", 1, false},
        {"alpha", 1, false},
        {"variance", 3, false},
        {"diffuse.variance", 3, false},
        {"specular.variance", 3, false},
        {"samples.descriptor", 36, true},
        {"samples.density", 1, true},
        {"samples.valid", 1, true},
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

} // namespace pathfold::core
