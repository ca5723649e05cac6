#include "descriptor.h"

#include <array>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include <pybind11/stl.h>

#include "pathfold/pathfold.hpp"

namespace py = pybind11;

namespace {

/// Name, channels, and whether it is of every sample.
std::vector<std::tuple<std::string, int, bool>> buffers() {
    size_t count = 0;
    const pathfold_buffer *first = pathfold_buffers(&count);
    std::vector<std::tuple<std::string, int, bool>> found;
    for (size_t i = 0; i < count; ++i)
        found.emplace_back(first[i].name, first[i].channels, first[i].per_sample != 0);
    return found;
}

pathfold_layout layout(int vertices) {
    if (vertices < 1)
        throw pathfold::Error(PATHFOLD_INVALID_ARGUMENT,
                              "vertices is " + std::to_string(vertices) + "; it must be at least 1");
    return pathfold_descriptor_layout(vertices);
}

using Color = std::array<float, 3>;
using Vertex = std::tuple<Color, int, float, float>;

std::pair<std::vector<float>, float> describe_path(const Color &light, const std::vector<Vertex> &path,
                                                   int vertices) {
    std::vector<pathfold_vertex> at;
    for (const auto &[attenuation, kind, roughness, density] : path)
        at.push_back({{attenuation[0], attenuation[1], attenuation[2]}, kind, roughness, density});
    const pathfold_path whole{{light[0], light[1], light[2]}, int32_t(at.size()), at.data()};
    std::vector<float> channels(size_t(layout(vertices).channels));
    float density = 0;
    pathfold::describe_path(whole, channels.data(), &density, vertices);
    return {channels, density};
}

} // namespace

void bind_descriptor(py::module_ &module) {
    module.attr("MAX_VERTICES") = PATHFOLD_MAX_VERTICES;
    module.attr("DEAD_LOG") = PATHFOLD_DEAD_LOG;
    module.attr("LEAST_VALUE") = PATHFOLD_LEAST_VALUE;
    py::dict kinds;
    for (auto [name, kind] : {std::pair("none", PATHFOLD_KIND_NONE),
                              {"generic", PATHFOLD_KIND_GENERIC},
                              {"diffuse-reflection", PATHFOLD_KIND_DIFFUSE_REFLECTION},
                              {"diffuse-transmission", PATHFOLD_KIND_DIFFUSE_TRANSMISSION},
                              {"glossy-reflection", PATHFOLD_KIND_GLOSSY_REFLECTION},
                              {"glossy-transmission", PATHFOLD_KIND_GLOSSY_TRANSMISSION},
                              {"delta-reflection", PATHFOLD_KIND_DELTA_REFLECTION},
                              {"delta-transmission", PATHFOLD_KIND_DELTA_TRANSMISSION}})
        kinds[name] = int(kind);
    module.attr("KINDS") = kinds;
    py::class_<pathfold_layout>(module, "Layout",
                                "Where the channels of a path descriptor lie; see pathfold.h.")
        .def(py::init(&layout), py::arg("vertices") = PATHFOLD_MAX_VERTICES)
        .def_readonly("radiance", &pathfold_layout::radiance)
        .def_readonly("light", &pathfold_layout::light)
        .def_readonly("attenuation", &pathfold_layout::attenuation)
        .def_readonly("kind", &pathfold_layout::kind)
        .def_readonly("roughness", &pathfold_layout::roughness)
        .def_readonly("channels", &pathfold_layout::channels);
    module.def("descriptor_vertices", &pathfold_descriptor_vertices, py::arg("channels"),
               "The vertices that a descriptor of so many channels holds; 0 where it is none.");
    module.def("buffers", &buffers, "All buffers of a frame: (name, channels, whether of every sample).");
    module.def("describe_path", &describe_path, py::arg("light"), py::arg("path"),
               py::arg("vertices") = PATHFOLD_MAX_VERTICES,
               "The descriptor's channels and the density of one path; see pathfold_describe_path. light: "
               "its RGB; path: "
               "(RGB attenuation, kind, roughness, density) of each vertex.");
}
