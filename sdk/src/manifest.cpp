#include "manifest.h"

#include <algorithm>
#include <cctype>
#include <set>

#include "buffers.h"
#include "embedding.h"
#include "error.h"
#include "fields.h"

namespace pathfold::core {
namespace {

constexpr int format_version = 1;
constexpr int max_kernel = 63;
constexpr int64_t max_embedding = 64; // their sums are held for the whole frame
constexpr double max_error = 1.02;    // of a variant's RelL2 over that of the graphs that it stands in for

Shape read_shape(const Field &field) {
    Shape shape;
    for (const Field &axis : field.items()) {
        Dim dim;
        if (axis.is_string())
            dim.name = axis.one_of({dim_names().begin(), dim_names().end()});
        else
            dim.size = axis.integer(1, 1 << 20);
        shape.push_back(dim);
    }
    return shape;
}

void expect_shape(const Field &field, const Shape &shape, const Shape &right) {
    if (!(shape == right))
        field.wrong(shape_text(right));
}

std::vector<std::string> read_buffers(const Field &field) {
    std::vector<std::string> names;
    for (const Field &item : field.items()) {
        if (find_buffer(item.string()) == nullptr)
            item.wrong("the name of a buffer: ", buffer_names());
        if (std::find(names.begin(), names.end(), item.string()) != names.end())
            item.wrong("there once");
        names.push_back(item.string());
    }
    return names;
}

void read_file(const Field &field, Graph &graph) {
    const Field file = field.at("file"), hash = field.at("sha256");
    graph.file = file.string();
    if (graph.file.empty() || graph.file[0] == '.' || graph.file.find_first_of("/\\:") != std::string::npos)
        file.wrong("the name of a file in the model's folder, without a path");
    graph.sha256 = hash.string();
    const auto is_digit = [](unsigned char c) { return std::isdigit(c) || (c >= 'a' && c <= 'f'); };
    if (graph.sha256.size() != 64 || !std::all_of(graph.sha256.begin(), graph.sha256.end(), is_digit))
        hash.wrong("64 lower-case hexadecimal digits");
}

/// `channels` of what the graph "embedding" gives, 0 where there is none.
Graph read_graph(const Field &field, const std::map<std::string, Shape> &outputs, int64_t channels) {
    field.keys({"file", "sha256", "inputs", "outputs"});
    Graph graph;
    read_file(field, graph);
    for (const auto &[name, input] : field.at("inputs").members()) {
        const bool embedded = name == "embedding" && channels > 0;
        const Shape right = embedded ? embedding_shape(channels) : input_shape(name);
        if (name == "embedding" && channels == 0)
            fail(PATHFOLD_INVALID_MODEL,
                 "manifest.json: a graph has the input embedding, but graphs.embedding is missing");
        if (right.empty())
            fail(PATHFOLD_INVALID_MODEL, "manifest.json: a graph has the input ", name,
                 ", which this version does not know how to feed");
        graph.inputs[name] = read_shape(input);
        expect_shape(input, graph.inputs[name], right);
    }
    std::set<std::string> names;
    for (const auto &[name, right] : outputs)
        names.insert(name);
    const Field given = field.at("outputs").keys(names);
    for (const auto &[name, right] : outputs) {
        graph.outputs[name] = read_shape(given.at(name));
        expect_shape(given.at(name), graph.outputs[name], right);
    }
    return graph;
}

/// The graph "embedding" sees samples alone: what it gives is summed over parts of them.
void check_embedding(const Field &field, const Graph &graph) {
    const auto of_samples = [](const auto &input) { return input.first.rfind("samples.", 0) == 0; };
    const auto fits = [&](const auto &input) {
        return of_samples(input) || input.first == "exposure" || input.first == "depth_scale";
    };
    const auto &inputs = graph.inputs;
    if (!std::all_of(inputs.begin(), inputs.end(), fits) ||
        std::none_of(inputs.begin(), inputs.end(), of_samples))
        field.at("inputs").wrong("samples' buffers and, if wanted, exposure and depth_scale");
}

void read_graphs(const Field &field, Manifest &manifest) {
    std::map<std::string, Shape> embedding;
    if (field.has("embedding")) {
        const Field output = field.at("embedding").at("outputs").at("embedding");
        const std::vector<Field> axes = output.items();
        if (axes.size() != 4)
            output.wrong("[1, channels, H/2, W/2]");
        manifest.embedding_channels = axes[1].integer(1, max_embedding);
        embedding["embedding"] = embedding_shape(manifest.embedding_channels);
    }
    const std::map<std::string, Shape> predicted = make_operator(manifest.reconstruction)->outputs();
    bool read = embedding.empty();
    for (const auto &[name, item] : field.members()) {
        const bool embeds = name == "embedding";
        Graph graph = read_graph(item, embeds ? embedding : predicted, manifest.embedding_channels);
        if (embeds)
            check_embedding(item, graph);
        else
            read = read || graph.inputs.count("embedding") > 0;
        manifest.graphs[name] = std::move(graph);
    }
    if (!read)
        fail(PATHFOLD_INVALID_MODEL,
             "manifest.json: there is graphs.embedding, but no graph has the input embedding");
}

void read_variants(const Field &field, Manifest &manifest) {
    field.keys({"int8"});
    for (const auto &[precision, variant] : field.members()) {
        variant.keys({"rell2_over_fp32", "graphs"});
        variant.at("rell2_over_fp32").number(0, max_error);
        for (const auto &[name, item] : variant.at("graphs").members()) {
            const auto original = manifest.graphs.find(name);
            if (original == manifest.graphs.end())
                fail(PATHFOLD_INVALID_MODEL, "manifest.json: variants.", precision, " has the graph ", name,
                     ", which is not among graphs");
            Graph &graph = manifest.variants[precision][name] = original->second;
            read_file(item.keys({"file", "sha256"}), graph);
        }
    }
}

Branch read_branch(const Field &field) {
    field.keys({"name", "graph", "radiance", "demodulate", "unsplit"});
    Branch branch;
    branch.name = field.at("name").string();
    branch.graph = field.at("graph").string();
    branch.radiance = field.at("radiance").one_of({"color", "diffuse", "specular"});
    branch.unsplit = field.has("unsplit") && field.at("unsplit").boolean();
    if (field.has("demodulate")) {
        const Field demodulate = field.at("demodulate").keys({"by", "epsilon", "clean"});
        branch.demodulate_by = demodulate.at("by").one_of({"albedo", "diffuse.albedo"});
        branch.epsilon = float(demodulate.at("epsilon").number(1e-6, 1));
        branch.clean = demodulate.has("clean") && demodulate.at("clean").boolean();
    }
    return branch;
}

void read_reconstruction(const Field &field, Manifest &manifest) {
    Reconstruction &how = manifest.reconstruction;
    std::set<std::string> names;
    for (const auto &[name, kind] : operators())
        names.insert(name);
    how.name = field.at("operator").one_of(names);
    const OperatorKind &kind = operators().at(how.name);
    std::set<std::string> keys = kind.options;
    keys.insert({"operator", "branches"});
    field.keys(keys);
    if (kind.options.count("size") > 0) {
        how.size = int(field.at("size").integer(1, max_kernel));
        if (how.size % 2 == 0)
            field.at("size").wrong("odd");
    }
    how.trust = field.has("trust") && field.at("trust").boolean();
    const Field branches = field.at("branches");
    for (const Field &item : branches.items())
        manifest.branches.push_back(read_branch(item));
    const auto unsplit = [](const Branch &branch) { return branch.unsplit; };
    if (std::count_if(manifest.branches.begin(), manifest.branches.end(), unsplit) != 1)
        branches.wrong("branches of which exactly one has \"unsplit\": true");
    // color, layers and all can be divided by one guide, but not by that of diffuse radiance alone
    const Branch &whole = manifest.unsplit_branch();
    if (!whole.demodulate_by.empty() && !(whole.radiance == "color" && whole.demodulate_by == "albedo"))
        branches.wrong(
            "such that the branch with \"unsplit\" has no \"demodulate\", or is color's, by albedo");
    std::set<std::string> radiance;
    for (const Branch &branch : manifest.branches) {
        radiance.insert(branch.radiance);
        if (branch.clean && !(kind.cleans && branch.unsplit))
            branches.wrong("without \"clean\" but in a pyramid's branch with \"unsplit\"");
    }
    const bool known = radiance == std::set<std::string>{"color"} ||
                       radiance == std::set<std::string>{"diffuse", "specular"};
    if (!known || radiance.size() != manifest.branches.size())
        branches.wrong("one branch with the radiance color, or two with diffuse and specular");
    how.clean = whole.clean;
}

/// The buffer behind a graph input; empty for scalars and flags.
std::string buffer_of(const std::string &input) {
    return find_buffer(input) != nullptr ? input : std::string();
}

void check_references(const Manifest &manifest) {
    for (const Branch &branch : manifest.branches) {
        if (manifest.graphs.count(branch.graph) == 0)
            fail(PATHFOLD_INVALID_MODEL, "manifest.json: the branch ", branch.name, " names the graph ",
                 branch.graph, ", which is not among graphs");
        if (branch.graph == "embedding")
            fail(PATHFOLD_INVALID_MODEL, "manifest.json: the branch ", branch.name,
                 " names the graph embedding, which sees samples; name one that gives kernels");
        if (!branch.demodulate_by.empty() && !manifest.reads(branch.demodulate_by))
            fail(PATHFOLD_INVALID_MODEL, "manifest.json: the branch ", branch.name, " divides by ",
                 branch.demodulate_by, ", which is in neither requires nor uses");
    }
    for (const auto &[name, graph] : manifest.graphs)
        for (const auto &[input, shape] : graph.inputs)
            if (const std::string buffer = buffer_of(input); !buffer.empty() && !manifest.reads(buffer))
                fail(PATHFOLD_INVALID_MODEL, "manifest.json: graphs.", name, " has the input ", input,
                     ", which is in neither requires nor uses");
}

} // namespace

Shape input_shape(const std::string &name) {
    const Dim one{1, ""}, height{-1, "H"}, width{-1, "W"}, samples{-1, "S"};
    if (name == "exposure" || name == "depth_scale")
        return {one};
    for (const char *flag : {"variance.present", "split.present", "paths.present"})
        if (name == flag)
            return {one};
    for (const Guide &guide : guides())
        if (guide.flagged && name == guide.name + std::string(".present"))
            return {one};
    if (name == "radiance")
        return {one, {3, ""}, height, width};
    if (name == "variance" || find_guide(name) != nullptr)
        return {one, {find_buffer(name)->channels, ""}, height, width};
    if (const BufferKind *kind = find_buffer(name); kind != nullptr && kind->per_sample)
        return {samples, {kind->channels, ""}, height, width};
    return {};
}

Shape embedding_shape(int64_t channels) { return {{1, ""}, {channels, ""}, {-1, "H/2"}, {-1, "W/2"}}; }

const Branch &Manifest::unsplit_branch() const {
    return *std::find_if(branches.begin(), branches.end(), [](const Branch &b) { return b.unsplit; });
}

bool Manifest::reads(const std::string &buffer) const {
    const auto in = [&](const std::vector<std::string> &names) {
        return std::find(names.begin(), names.end(), buffer) != names.end();
    };
    return in(requires_) || in(uses);
}

Manifest Manifest::parse(const std::string &text) {
    const nlohmann::json json = read_json(text);
    const Field root(json, "");
    if (!json.is_object())
        fail(PATHFOLD_INVALID_MODEL, "manifest.json must hold one object");
    const int64_t format = root.at("format").integer(1, 1 << 30);
    if (format > format_version)
        fail(PATHFOLD_UNSUPPORTED, "manifest.json has format ", format, "; this pathfold reads format ",
             format_version, ": take a newer pathfold or a model exported for this one");
    root.keys({"format", "name", "description", "license", "requires", "uses", "graphs", "reconstruction",
               "exposure", "tile", "samples_per_pixel", "precision", "variants", "training"});
    Manifest manifest;
    manifest.text = text;
    manifest.name = root.at("name").string();
    if (manifest.name.empty())
        root.at("name").wrong("a string that is not empty");
    manifest.description = root.has("description") ? root.at("description").string() : "";
    manifest.license = root.at("license").string();
    manifest.requires_ = read_buffers(root.at("requires"));
    manifest.uses = read_buffers(root.at("uses"));
    read_reconstruction(root.at("reconstruction"), manifest);
    read_graphs(root.at("graphs"), manifest);
    const Field exposure = root.at("exposure").keys({"rule", "key"});
    exposure.at("rule").one_of({"log-average"});
    manifest.exposure_key = float(exposure.at("key").number(1e-3, 1e3));
    const Field tile = root.at("tile").keys({"alignment", "overlap"});
    manifest.tile_alignment = int(tile.at("alignment").integer(1, 1024));
    const std::unique_ptr<Operator> how = make_operator(manifest.reconstruction);
    const int aligned =
        std::max(how->alignment(), manifest.embedding_channels > 0 ? Embedding::alignment : 1);
    if (manifest.tile_alignment % aligned != 0)
        tile.at("alignment").wrong("a multiple of ", aligned, " for a pyramid or an embedding");
    manifest.tile_overlap = int(tile.at("overlap").integer(how->least_overlap(), 4096));
    const Field samples = root.at("samples_per_pixel").keys({"min", "max", "embedded", "without_paths"});
    manifest.min_samples = samples.at("min").integer(1, 1 << 30);
    manifest.max_samples = samples.at("max").integer(manifest.min_samples, 1 << 30);
    if (samples.has("embedded")) {
        if (manifest.embedding_channels == 0)
            samples.at("embedded").wrong("left out in a model without graphs.embedding");
        manifest.embedded_samples = samples.at("embedded").integer(1, 1 << 30);
    }
    if (samples.has("without_paths"))
        manifest.without_paths = samples.at("without_paths").integer(1, 1 << 30);
    root.at("precision").one_of({"fp32"});
    if (root.has("variants"))
        read_variants(root.at("variants"), manifest);
    if (root.has("training") && !json.at("training").is_object())
        root.at("training").wrong("an object");
    check_references(manifest);
    return manifest;
}

} // namespace pathfold::core
