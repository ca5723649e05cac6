#include "denoiser.h"

#include <algorithm>
#include <vector>

#include "error.h"
#include "filter.h"
#include "needs.h"
#include "report.h"

namespace pathfold::core {

/// One frame on its way through the stages.
class Denoiser::Run {
public:
    Run(Denoiser &denoiser, const Frame &frame, const Reads &reads, const Settings &settings)
        : denoiser_(denoiser), frame_(frame), settings_(settings), model_(*denoiser.model_),
          manifest_(model_.manifest()), threads_(denoiser.threads_), operator_(*denoiser.operator_),
          guides_(frame, reads, manifest_.requires_, threads_), reads_(settle(reads)),
          prepared_(prepare(frame, reads_, guides_, settings.exposure, manifest_.exposure_key, threads_)),
          packer_(frame, reads_, guides_, prepared_, model_, threads_, denoiser.tensors_),
          report_(reads_.branches.size()) {
        report_.times.prepare = watch_.lap();
        plan_ = make_plan(frame, reads_, model_, operator_, settings);
        for (size_t i = 0; i < reads_.branches.size(); ++i)
            filters_.emplace_back(prepared_, int(i), frame.width(), frame.height());
    }

    std::string go() {
        watch_.lap();
        const Rect whole{0, 0, frame_.width(), frame_.height()};
        for (size_t i = 0; i < filters_.size(); ++i)
            idle_.push_back(settings_.leaves_out("branches") &&
                            is_idle(prepared_, int(i), {whole, whole}, 0));
        report_.times.needs += watch_.lap();
        for (size_t i = 0; i < plan_.tiles.size(); ++i)
            denoise(plan_.tiles[i], i);
        tell_progress(1);
        report_.samples_dropped = packer_.dropped();
        return report_.json(frame_, reads_, model_, settings_, prepared_, plan_);
    }

private:
    Reads settle(const Reads &reads);
    std::vector<std::string> find_needs(const Tile &tile) const;
    void denoise(const Tile &tile, size_t index);
    void embed();
    void filter(const Tile &tile, int branch);
    void write(const Tile &tile);
    void tell_progress(float done);

    Denoiser &denoiser_;
    const Frame &frame_;
    const Settings &settings_;
    const Model &model_;
    const Manifest &manifest_;
    Threads &threads_;
    Operator &operator_;
    Stopwatch watch_;
    Guides guides_;
    Reads reads_;
    Prepared prepared_;
    Packer packer_;
    Report report_;
    Plan plan_;
    std::vector<Filter> filters_; // per branch
    std::vector<char> idle_;      // per branch: in the whole frame
    float told_ = 0;              // the progress
    bool embedded_ = false;       // the frame's samples, where the model does so
};

/// What the run reads without the guides that say nothing, and with what it reads in their stead.
Reads Denoiser::Run::settle(const Reads &reads) {
    for (Reads left = without(frame_, guides_.silent(), reads, manifest_, settings_);;) {
        const size_t silent = guides_.silent().size();
        guides_.look_at_all(left, manifest_.requires_, threads_);
        if (guides_.silent().size() == silent)
            return left;
        left = without(frame_, guides_.silent(), reads, manifest_, settings_);
    }
}

/// For each branch what it is left out of the tile for; empty where it has to run.
std::vector<std::string> Denoiser::Run::find_needs(const Tile &tile) const {
    const size_t branches = filters_.size();
    const bool leaves_branches = settings_.leaves_out("branches"),
               leaves_tiles = settings_.leaves_out("tiles");
    std::vector<std::string> causes(branches);
    std::vector<char> idle(branches);
    bool all_idle = true;
    for (size_t i = 0; i < branches; ++i) {
        idle[i] = idle_[i] ||
                  ((leaves_branches || leaves_tiles) && is_idle(prepared_, int(i), tile, operator_.reach()));
        all_idle = all_idle && idle[i];
    }
    for (size_t i = 0; i < branches; ++i)
        if (idle_[i] && leaves_branches)
            causes[i] = "branches";
        else if (all_idle && leaves_tiles)
            causes[i] = "tiles";
        else if (idle[i] && leaves_branches)
            causes[i] = "branches";
    if (settings_.leaves_out("converged") && std::count(causes.begin(), causes.end(), "") > 0 &&
        is_converged(frame_, reads_, prepared_, tile.core))
        std::replace(causes.begin(), causes.end(), std::string(), std::string("converged"));
    return causes;
}

void Denoiser::Run::denoise(const Tile &tile, size_t index) {
    bool packed = false;
    const size_t branches = filters_.size();
    watch_.lap();
    const std::vector<std::string> causes = find_needs(tile);
    report_.times.needs += watch_.lap();
    for (size_t branch = 0; branch < branches; ++branch) {
        tell_progress(float(index * branches + branch) / float(plan_.tiles.size() * branches));
        watch_.lap();
        if (!causes[branch].empty()) {
            filters_[branch].keep(tile);
            report_.left_out[branch][causes[branch]].add(tile);
            continue;
        }
        if (!packed) {
            if (!embedded_ && manifest_.embedding_channels > 0)
                embed();
            packer_.start(tile, denoiser_.embedding_);
        }
        packed = true;
        filter(tile, int(branch));
        report_.done[branch].add(tile);
    }
    watch_.lap();
    write(tile);
    report_.times.write += watch_.lap();
}

/// Brings the frame's first samples, as many as the model wants, through its embedding, in parts that stay in
/// the caches.
void Denoiser::Run::embed() {
    constexpr int64_t part = 16 * 1024; // samples, for each thread
    Embedding &embedding = denoiser_.embedding_;
    const int width = frame_.width(), height = frame_.height();
    embedding.reset(manifest_.embedding_channels, height, width);
    embedded_ = true;
    if (!reads_.has("samples.descriptor"))
        return;
    const Session &session = model_.session("embedding");
    const int64_t spp = std::min(reads_.samples, manifest_.embedded_samples),
                  most = part * std::min(model_.threads(), 16);
    const int step = Embedding::alignment;
    const int rows = int(std::max<int64_t>(1, most / (width * spp * step))) * step;
    const int64_t count = std::clamp<int64_t>(most / (int64_t(width) * rows), 1, spp);
    for (int y = 0; y < height; y += rows) {
        const Rect strip{0, y, width, std::min(rows, height - y)};
        const std::vector<int64_t> shape{1, manifest_.embedding_channels, Embedding::cells(strip.height),
                                         Embedding::cells(width)};
        std::vector<float> sums(size_t(shape[1] * shape[2] * shape[3]));
        tell_progress(told_); // it may cancel; tiles that need no network came before
        for (int64_t first = 0; first < spp; first += count) {
            session.run(packer_.samples(strip, first, std::min(count, spp - first)),
                        {{"embedding", shape, sums.data()}}, threads_.stop(), denoiser_.pool_);
            embedding.add(strip, sums.data());
        }
    }
    report_.times.embedding += watch_.lap();
}

void Denoiser::Run::filter(const Tile &tile, int branch) {
    Prediction &prediction = denoiser_.prediction_;
    const std::string &graph = reads_.branches[size_t(branch)].branch->graph;
    const std::vector<Tensor> inputs = packer_.inputs(branch);
    const std::vector<Tensor> outputs =
        prediction.reset(model_.graph(graph).outputs, tile.window, std::max<int64_t>(1, reads_.samples));
    report_.times.pack += watch_.lap();
    model_.session(graph).run(inputs, outputs, threads_.stop(), denoiser_.pool_);
    if (settings_.memory_mb > 0) // windows differ in size, and each would leave blocks of its own
        denoiser_.pool_.release();
    report_.times.network += watch_.lap();
    filters_[size_t(branch)].apply(threads_, operator_, prediction, tile);
    report_.times.reconstruct += watch_.lap();
}

void Denoiser::Run::write(const Tile &tile) {
    const auto write_signals = [&](const ImageView &output, const std::vector<size_t> &signals) {
        report_.repaired += write_tile(threads_, prepared_, filters_, signals, tile.core, output);
    };
    const auto signals_of = [&](const std::string &name) {
        std::vector<size_t> found;
        for (size_t i = 0; i < prepared_.signals.size(); ++i)
            if (prepared_.signals[i].name == name || (name == "color" && i < filters_.size()))
                found.push_back(i); // color is the sum of the branches' radiance
        return found;
    };
    for (const auto &[name, view] : frame_.outputs())
        write_signals(view, signals_of(name));
    for (const Layer &layer : frame_.layers())
        if (!layer.output.empty())
            write_signals(layer.output, signals_of(layer.name));
}

void Denoiser::Run::tell_progress(float done) {
    told_ = done;
    threads_.stop().check();
    if (settings_.progress && !settings_.progress(done))
        fail(PATHFOLD_CANCELLED, "cancelled by the progress callback");
}

Denoiser::Denoiser(std::shared_ptr<const Model> model)
    : model_(std::move(model)), threads_(model_->threads()),
      operator_(make_operator(model_->manifest().reconstruction)) {}

std::string Denoiser::run(const Frame &frame, const Settings &settings) {
    threads_.stop().reset();
    frame.check();
    frame.check_data();
    const Reads reads = decide_reads(frame, model_->manifest(), settings);
    check_reads(frame, model_->manifest(), reads);
    const Plan plan = make_plan(frame, reads, *model_, *operator_, settings);
    const int64_t needed = plan.window_bytes + plan.frame_bytes;
    if (2 * needed < held_)
        forget(); // a much larger frame came before
    held_ = std::max(held_, needed);
    pool_.start(memory_bound(plan));
    std::string report = Run(*this, frame, reads, settings).go();
    pool_.finish();
    return report;
}

void Denoiser::forget() {
    tensors_.clear();
    embedding_ = Embedding();
    prediction_ = Prediction();
    operator_ = make_operator(model_->manifest().reconstruction);
    pool_.release();
    held_ = 0;
}

Plan Denoiser::plan(const Frame &frame, const Settings &settings) const {
    frame.check();
    const Reads reads = decide_reads(frame, model_->manifest(), settings);
    check_reads(frame, model_->manifest(), reads);
    return make_plan(frame, reads, *model_, *operator_, settings);
}

} // namespace pathfold::core
