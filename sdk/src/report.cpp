#include "report.h"

#include <algorithm>

#include <nlohmann/json.hpp>

#include "error.h"
#include "needs.h"

namespace pathfold::core {
namespace {

using Json = nlohmann::json;

/// A line on something that was not computed; `saved_ms` by the mean time of what was computed, negative: not
/// known.
Json line(const std::string &what, const std::string &why, double saved_ms = -1) {
    Json json = {{"what", what}, {"why", why}};
    if (saved_ms >= 0)
        json["saved_ms"] = saved_ms;
    return json;
}

/// Words on the work of a report.
class Lines {
public:
    Lines(const Report &report, const Plan &plan) : report_(report), tiles_(plan.tiles.size()) {}

    void add_branches(const Reads &reads, Json &lines) const {
        for (size_t i = 0; i < reads.branches.size(); ++i) {
            const Work idle = work(i, "branches");
            if (idle.tiles == 0)
                continue;
            const std::string where = idle.tiles == tiles_ ? "" : " in " + tiles_text(idle.tiles);
            lines.push_back(line("branch " + reads.branches[i].branch->name + where,
                                 reads.branches[i].radiance + " is constant there: filtering changes nothing",
                                 saved_ms(idle.pixels)));
        }
    }

    void add_tiles(const std::string &cause, const std::string &why, Json &lines) const {
        size_t tiles = 0;
        double pixels = 0;
        for (size_t i = 0; i < report_.left_out.size(); ++i) {
            tiles = std::max(tiles, work(i, cause).tiles);
            pixels += work(i, cause).pixels;
        }
        if (tiles > 0)
            lines.push_back(line(tiles_text(tiles), why, saved_ms(pixels)));
    }

private:
    Work work(size_t branch, const std::string &cause) const {
        const auto found = report_.left_out[branch].find(cause);
        return found == report_.left_out[branch].end() ? Work() : found->second;
    }

    /// What the work on so many pixels of windows would have taken, by what it took in this run; -1: not
    /// known.
    double saved_ms(double pixels) const {
        double done = 0;
        for (const Work &work : report_.done)
            done += work.pixels;
        const Times &times = report_.times;
        return done > 0 ? pixels * (times.pack + times.network + times.reconstruct) / done : -1;
    }

    std::string tiles_text(size_t tiles) const {
        return tiles == tiles_ ? "all tiles" : text(tiles, " of ", tiles_, " tiles");
    }

    const Report &report_;
    size_t tiles_;
};

Json describe_inputs(const Frame &frame, const Manifest &manifest, const Reads &reads) {
    Json missing = Json::array();
    for (const auto *names : {&manifest.requires_, &manifest.uses})
        for (const std::string &name : *names)
            if (!frame.has(name) && !(name == "color" && reads.split))
                missing.push_back(name);
    return {{"used", reads.buffers}, {"unused", reads.unread}, {"missing", missing}};
}

/// Vertices of paths that are not given: what reading them would have taken, by what reading radiance took.
void add_vertices(const ImageView &descriptor, const Prepared &prepared, Json &lines) {
    const int vertices = pathfold_descriptor_vertices(descriptor.channels());
    if (vertices == PATHFOLD_MAX_VERTICES)
        return;
    const int missing = pathfold_descriptor_layout(PATHFOLD_MAX_VERTICES).channels - descriptor.channels();
    const double values = double(descriptor.samples()) * missing * descriptor.width() * descriptor.height();
    lines.push_back(line(text("path vertices from ", vertices + 1, " on"),
                         "no path of the frame has them: they are not given",
                         prepared.load_ms / prepared.loaded * values));
}

Json describe_left_out(const Report &report, const Frame &frame, const Reads &reads, const Manifest &manifest,
                       const Prepared &prepared, const Plan &plan) {
    Json lines = Json::array();
    if (reads.without_paths)
        lines.push_back(line("paths", text("approximately: from ", manifest.without_paths,
                                           " samples per pixel on the model's RelL2 without them is at most "
                                           "1.02 times that with them, in the mean")));
    const Lines words(report, plan);
    words.add_branches(reads, lines);
    words.add_tiles("tiles", "everything in them is constant: filtering changes nothing", lines);
    words.add_tiles("converged",
                    text("approximately: their expected RelL2 is at most ", converged_error, " already"),
                    lines);
    if (reads.has("samples.descriptor"))
        add_vertices(frame.input("samples.descriptor"), prepared, lines);
    return lines;
}

Json describe_notes(const Frame &frame, const Reads &reads, const Model &model, const Settings &settings,
                    const Prepared &prepared, const Plan &plan) {
    const Manifest &manifest = model.manifest();
    Json notes = prepared.notes;
    if (model.asked_threads() > model.threads())
        notes.push_back(text(model.asked_threads(), " threads were asked for; ", model.threads(),
                             " ran, one for each processor that this process may use"));
    if (settings.leaves_out("paths") && !reads.without_paths && frame.has("samples.descriptor") &&
        manifest.without_paths == 0)
        notes.push_back("paths are not left out: the model's manifest does not say from how many samples per "
                        "pixel on it does as well without");
    const int64_t most = manifest.embedded_samples, samples = reads.samples_behind;
    if (reads.has("samples.descriptor") && most < reads.samples)
        notes.push_back(text("of ", reads.samples, " samples' paths the model looks at the first ", most));
    if (samples > 0 && (samples < manifest.min_samples || samples > manifest.max_samples))
        notes.push_back(text(samples, " samples per pixel; the model was trained on ", manifest.min_samples,
                             " to ", manifest.max_samples));
    const int64_t held = plan.window_bytes >> 20;
    if (settings.tile > 0 && settings.memory_mb > 0 && held > settings.memory_mb)
        notes.push_back(text("tile is ", settings.tile, ", whose window holds ", held, " MB: memory_mb, ",
                             settings.memory_mb, ", bounds what is chosen; leave tile out"));
    return notes;
}

} // namespace

std::string Report::json(const Frame &frame, const Reads &reads, const Model &model, const Settings &settings,
                         const Prepared &prepared, const Plan &plan) const {
    const Manifest &manifest = model.manifest();
    Mended mended = prepared.mended;
    tally(mended, "samples", fault::dropped, samples_dropped);
    Json branches = Json::array();
    for (size_t i = 0; i < done.size(); ++i)
        if (done[i].tiles > 0)
            branches.push_back(reads.branches[i].branch->name);
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
        {"sanitised", mended},
        {"repaired", repaired},
        {"branches", branches},
        {"left_out", describe_left_out(*this, frame, reads, manifest, prepared, plan)},
        {"notes", describe_notes(frame, reads, model, settings, prepared, plan)},
        {"tiles", plan.tiles.size()},
        {"tile", {plan.tiles[0].core.width, plan.tiles[0].core.height}},
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
