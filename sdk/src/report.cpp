#include "report.h"

#include <nlohmann/json.hpp>

namespace pathfold::core {

using Json = nlohmann::json;

namespace {

Json describe_inputs(const Frame &frame, const Manifest &manifest, const Reads &reads) {
    Json missing = Json::array();
    for (const auto *names : {&manifest.requires_, &manifest.uses})
        for (const std::string &name : *names)
            if (!frame.has(name) && !(name == "color" && reads.split))
                missing.push_back(name);
    return {{"used", reads.buffers}, {"unused", reads.unread}, {"missing", missing}};
}

Json describe_left_out(const std::vector<LeftOut> &left_out) {
    Json lines = Json::array();
    for (const LeftOut &item : left_out) {
        Json line = {{"what", item.what}, {"why", item.why}};
        if (item.saved_ms >= 0)
            line["saved_ms"] = item.saved_ms;
        lines.push_back(line);
    }
    return lines;
}

} // namespace

std::string Report::json(const Frame &frame, const Reads &reads, const Model &model,
                         const Prepared &prepared) const {
    const Manifest &manifest = model.manifest();
    const Json report = {
        {"model", manifest.name},
        {"precision", model.precision()},
        {"provider", model.provider()},
        {"threads", model.threads()},
        {"width", frame.width()},
        {"height", frame.height()},
        {"samples_per_pixel", reads.samples_behind},
        {"split", reads.split},
        {"exposure", prepared.exposure},
        {"depth_scale", prepared.depth_scale},
        {"inputs", describe_inputs(frame, manifest, reads)},
        {"sanitised",
         {{"non_finite", counts.non_finite},
          {"negative", counts.negative},
          {"capped", counts.capped},
          {"samples_dropped", counts.samples_dropped},
          {"repaired", counts.repaired}}},
        {"branches", branches},
        {"left_out", describe_left_out(left_out)},
        {"notes", notes},
        {"tiles", tiles},
        {"tile", {tile_width, tile_height}},
        {"ms",
         {{"prepare", times.prepare},
          {"needs", times.needs},
          {"embedding", times.embedding},
          {"pack", times.pack},
          {"network", times.network},
          {"reconstruct", times.reconstruct},
          {"write", times.write},
          {"total", times.total()}}},
    };
    return report.dump();
}

} // namespace pathfold::core
