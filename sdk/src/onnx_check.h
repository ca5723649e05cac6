#pragma once

#include <cstddef>
#include <string>

namespace pathfold::core {

/// Reads an ONNX file's structure before any engine sees it. Throws invalid-model, calling the file `name`,
/// unless it is a whole ONNX model with operators of the allow-list only: no subgraphs, no local functions,
/// no custom domains and no data outside the file.
void check_onnx(const void *data, size_t size, const std::string &name);

} // namespace pathfold::core
