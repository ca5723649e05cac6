#include "descriptor.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "error.h"

namespace pathfold::core {
namespace {

const pathfold_layout whole = pathfold_descriptor_layout(PATHFOLD_MAX_VERTICES);

/// The largest values have logarithms of 88.7: they need no bound.
float log_of(float value) {
    if (value == 0)
        return PATHFOLD_DEAD_LOG;
    return std::log(std::max(value, PATHFOLD_LEAST_VALUE));
}

/// Of a vertex that is there.
bool is_kind(int32_t kind) {
    switch (kind) {
    case PATHFOLD_KIND_GENERIC:
    case PATHFOLD_KIND_DIFFUSE_REFLECTION:
    case PATHFOLD_KIND_DIFFUSE_TRANSMISSION:
    case PATHFOLD_KIND_GLOSSY_REFLECTION:
    case PATHFOLD_KIND_GLOSSY_TRANSMISSION:
    case PATHFOLD_KIND_DELTA_REFLECTION:
    case PATHFOLD_KIND_DELTA_TRANSMISSION:
        return true;
    default:
        return false;
    }
}

/// Values that are not finite stay so: such a sample is dropped.
void expect_not_negative(const float *color, const char *name) {
    for (int c = 0; c < 3; ++c)
        if (color[c] < 0)
            fail(PATHFOLD_INVALID_ARGUMENT, name, " is ", color[c], "; it must be >= 0");
}

void clear(float *descriptor, const pathfold_layout &layout) {
    std::fill_n(descriptor, layout.kind, PATHFOLD_DEAD_LOG);
    std::fill(descriptor + layout.kind, descriptor + layout.channels, 0.0f);
}

} // namespace

void clear_descriptor(float *descriptor) { clear(descriptor, whole); }

void describe_path(const pathfold_path &path, int vertices, float *descriptor, float *density) {
    if (vertices < 1 || vertices > PATHFOLD_MAX_VERTICES)
        fail(PATHFOLD_INVALID_ARGUMENT, "vertices is ", vertices, "; it must be from 1 to ",
             PATHFOLD_MAX_VERTICES);
    const pathfold_layout layout = pathfold_descriptor_layout(vertices);
    if (path.vertex_count < 0 || (path.vertex_count > 0 && path.vertices == nullptr))
        fail(PATHFOLD_INVALID_ARGUMENT, "vertex_count is ", path.vertex_count,
             "; it must be >= 0, and vertices no null pointer where there are any");
    expect_not_negative(path.light, "light");
    clear(descriptor, layout);
    float product[3], log_density = 0;
    for (int c = 0; c < 3; ++c) {
        descriptor[layout.light + c] = log_of(path.light[c]);
        product[c] = std::log(path.light[c]);
    }
    for (int i = 0; i < std::min<int>(path.vertex_count, vertices); ++i) {
        const pathfold_vertex &vertex = path.vertices[i];
        expect_not_negative(vertex.attenuation, "attenuation");
        if (!is_kind(vertex.kind))
            fail(PATHFOLD_INVALID_ARGUMENT, "kind is ", vertex.kind,
                 "; it must be a pathfold_kind other than none");
        if (vertex.roughness < 0 || vertex.roughness > 1)
            fail(PATHFOLD_INVALID_ARGUMENT, "roughness is ", vertex.roughness, "; it must be in [0, 1]");
        if (vertex.density < 0)
            fail(PATHFOLD_INVALID_ARGUMENT, "density is ", vertex.density, "; it must be >= 0");
        for (int c = 0; c < 3; ++c) {
            descriptor[layout.attenuation + 3 * i + c] = log_of(vertex.attenuation[c]);
            product[c] += std::log(vertex.attenuation[c]);
        }
        descriptor[layout.kind + i] = float(vertex.kind);
        descriptor[layout.roughness + i] = vertex.roughness;
        log_density += std::log(std::max(vertex.density, PATHFOLD_LEAST_VALUE));
    }
    const float least = std::log(PATHFOLD_LEAST_VALUE);
    for (int c = 0; c < 3; ++c)
        descriptor[layout.radiance + c] =
            std::isinf(product[c]) && product[c] < 0 ? PATHFOLD_DEAD_LOG : std::max(product[c], least);
    if (density != nullptr)
        *density = log_density;
}

void add_vertices(float *descriptors, int count, int vertices) {
    const pathfold_layout part = pathfold_descriptor_layout(vertices);
    for (int x = count - 1; x >= 0 && vertices < PATHFOLD_MAX_VERTICES; --x) {
        const float *from = descriptors + size_t(x) * part.channels;
        const std::vector<float> in(from, from + part.channels);
        float *out = descriptors + size_t(x) * whole.channels;
        clear_descriptor(out);
        std::copy_n(in.data(), part.kind, out);
        std::copy_n(in.data() + part.kind, vertices, out + whole.kind);
        std::copy_n(in.data() + part.roughness, vertices, out + whole.roughness);
    }
}

} // namespace pathfold::core
