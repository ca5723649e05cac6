#include "reads.h"

#include <algorithm>

#include "error.h"

namespace pathfold::core {
namespace {

bool is_of_samples(const std::string &buffer) { return buffer.rfind("samples.", 0) == 0; }

/// The buffer that holds the variance of a radiance.
std::string variance_of(const std::string &radiance) {
    return radiance == "color" ? "variance" : radiance + ".variance";
}

bool is_split(const Frame &frame, const Manifest &manifest) {
    for (const Branch &branch : manifest.branches) {
        const bool modulated = branch.demodulate_by.empty() || frame.has(branch.demodulate_by);
        if (branch.radiance == "color" || !frame.has(branch.radiance) || !modulated)
            return false;
    }
    const std::vector<Layer> &layers = frame.layers();
    return std::all_of(layers.begin(), layers.end(), [](const Layer &layer) { return layer.split(); });
}

std::vector<ActiveBranch> find_branches(const Frame &frame, const Manifest &manifest, bool split) {
    std::vector<ActiveBranch> branches;
    if (split) {
        for (const Branch &branch : manifest.branches)
            branches.push_back({&branch,
                                branch.radiance,
                                {branch.radiance},
                                variance_of(branch.radiance),
                                branch.demodulate_by});
        return branches;
    }
    const Branch &branch = manifest.unsplit_branch();
    std::vector<std::string> parts = {"color"};
    if (!frame.has("color"))
        parts = {"diffuse", "specular"};
    const std::string factor = frame.has(branch.demodulate_by) ? branch.demodulate_by : "";
    return {{&branch, "color", parts, variance_of("color"), factor}};
}

/// Whether the model does as well on the frame without its path descriptors: its manifest says from how many
/// samples per pixel on, and does not require them.
bool does_without_paths(const Frame &frame, const Manifest &manifest, int64_t samples) {
    const auto &required = manifest.requires_;
    return manifest.without_paths > 0 && samples >= manifest.without_paths &&
           frame.has("samples.descriptor") && manifest.reads("samples.descriptor") &&
           std::none_of(required.begin(), required.end(), is_of_samples);
}

/// What a run would read if it was given.
std::set<std::string> find_wanted(const Manifest &manifest, const Reads &reads, const Settings &settings) {
    const std::set<std::string> of_branches = {"color",    "diffuse",          "specular",
                                               "variance", "diffuse.variance", "specular.variance"};
    std::set<std::string> wanted = {"alpha"};
    for (const auto *names : {&manifest.requires_, &manifest.uses})
        for (const std::string &name : *names)
            if (of_branches.count(name) == 0 && !(reads.without_paths && is_of_samples(name)))
                wanted.insert(name);
    // Training drops the demodulator together with the split, so an unsplit frame has none.
    if (!reads.split)
        wanted.erase("diffuse.albedo");
    for (const ActiveBranch &active : reads.branches) {
        wanted.insert(active.parts.begin(), active.parts.end());
        if (manifest.reads(active.variance) || settings.leaves_out("converged"))
            wanted.insert(active.variance);
        if (!active.factor.empty())
            wanted.insert(active.factor);
    }
    if (reads.split)
        wanted.insert("color"); // which its parts are compared with
    return wanted;
}

void check_required(const Frame &frame, const Manifest &manifest) {
    for (const std::string &name : manifest.requires_)
        if (!frame.has(name) && name != "color") // which is there, or its parts are
            fail(PATHFOLD_INVALID_ARGUMENT, "the model ", manifest.name, " requires the buffer ", name,
                 ", which was not given; given: ", list(frame.input_names()),
                 "; give it, or take a model that does without");
}

} // namespace

Reads decide_reads(const Frame &frame, const Manifest &manifest, const Settings &settings) {
    Reads reads;
    reads.split = is_split(frame, manifest);
    reads.branches = find_branches(frame, manifest, reads.split);
    reads.samples_behind = std::max(settings.samples_per_pixel, frame.samples());
    reads.without_paths =
        settings.leaves_out("paths") && does_without_paths(frame, manifest, reads.samples_behind);
    reads.samples = reads.without_paths ? 0 : frame.samples();
    const std::set<std::string> wanted = find_wanted(manifest, reads, settings);
    for (const auto &[name, view] : frame.inputs()) {
        if (wanted.count(name) > 0)
            reads.buffers.insert(name);
        else
            reads.unread.push_back(name);
    }
    return reads;
}

Reads without(const Frame &frame, const std::set<std::string> &silent, const Reads &reads,
              const Manifest &manifest, const Settings &settings) {
    if (silent.empty())
        return reads;
    Frame rest = frame;
    for (const std::string &buffer : silent)
        rest.set_input(buffer, nullptr);
    Reads found = decide_reads(rest, manifest, settings);
    found.unread.insert(found.unread.end(), silent.begin(), silent.end());
    std::sort(found.unread.begin(), found.unread.end());
    return found;
}

void check_reads(const Frame &frame, const Manifest &manifest, const Reads &reads) {
    check_required(frame, manifest);
    const auto &outputs = frame.outputs();
    if (outputs.count("alpha") > 0 && !frame.has("alpha"))
        fail(PATHFOLD_INVALID_ARGUMENT, "output alpha was asked for, but the frame has no alpha");
    for (const char *part : {"diffuse", "specular"})
        if (outputs.count(part) > 0 && !reads.split)
            fail(PATHFOLD_INVALID_ARGUMENT, "output ", part, " was asked for, but the frame is not split: ",
                 "diffuse, specular and diffuse.albedo are needed, and no layer that is not split");
    // What is filtered is held by the denoiser; guides and samples are read tile by tile.
    std::set<std::string> late = reads.buffers;
    for (const char *held : {"color", "diffuse", "specular", "alpha"})
        late.erase(held);
    const auto expect_apart = [&](const ImageView &output, const std::string &name) {
        for (const std::string &input : late)
            if (output.overlaps(frame.input(input)))
                fail(PATHFOLD_INVALID_ARGUMENT, "output ", name, " lies over the buffer ", input,
                     ", which is read until the end; give it memory of its own");
    };
    for (const auto &[name, view] : outputs)
        expect_apart(view, name);
    for (const Layer &layer : frame.layers())
        if (!layer.output.empty())
            expect_apart(layer.output, layer.name);
}

} // namespace pathfold::core
