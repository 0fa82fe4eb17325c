
#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "s2gs/backend/backend.h"
#include "s2gs/core/knn.h"
#include "s2gs/cpu/densify_state.h"
#include "s2gs/cpu/gaussian_pass.h"
#include "s2gs/cpu/regularise.h"
#include "s2gs/cpu/tile_kernel.h"
#include "s2gs/cpu/tile_lists.h"
#include "s2gs/cpu/view_buffers.h"
#include "s2gs/kernel/adam.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/thread_pool.h"

namespace s2gs {
namespace {

constexpr int64_t kChunk = 64;  // Gaussians whose gradients are in the cache at once.

Gaussians ZerosLike(const Gaussians& gaussians) {
  Gaussians zeros;
  zeros.Resize(gaussians.size());
  zeros.sh_degree = gaussians.sh_degree;
  return zeros;
}

// Every result is a sum in an order that does not depend on the threads: pixels of a tile, tiles of a splat
// in the order of its slots, rows of the image.
class CpuBackend : public Backend {
 public:
  explicit CpuBackend(int num_threads) : threads_(NumThreadsOf(num_threads)), kernels_(BestTileKernels()) {}

  BackendInfo Info() const override {
    BackendInfo info;
    info.kind = BackendKind::kCpu;
    info.device = std::to_string(threads_.num_threads()) +
                  (threads_.num_threads() == 1 ? " thread, " : " threads, ") + kernels_.name;
    const auto count = static_cast<int64_t>(state_.gaussians.size());
    info.memory_bytes = count * (3 * kFloatsPerGaussian + 2) * static_cast<int64_t>(sizeof(float)) +
                        static_cast<int64_t>(rows_.size() * sizeof(SplatRow)) +
                        static_cast<int64_t>(by_slot_.capacity() * sizeof(SplatGradient));
    info.peak_memory_bytes = info.memory_bytes;
    return info;
  }

  void SetPhotos(std::vector<TrainingPhoto> photos) override { photos_ = std::move(photos); }

  void SetState(const TrainState& state) override {
    state_ = state;
    if (state_.first_moment.empty()) state_.first_moment = ZerosLike(state_.gaussians);
    if (state_.second_moment.empty()) state_.second_moment = ZerosLike(state_.gaussians);
    const size_t count = state_.gaussians.size();
    if (state_.gradient_sum.empty()) state_.gradient_sum.assign(count, 0.0F);
    if (state_.view_count.empty()) state_.view_count.assign(count, 0.0F);
    S2GS_INVARIANT(state_.neighbours.size() == count * state_.num_neighbours);
  }

  TrainState GetState() const override { return state_; }
  Gaussians GetGaussians() const override { return state_.gaussians; }
  int64_t Count() const override { return static_cast<int64_t>(state_.gaussians.size()); }

  RenderedView Render(const RenderRequest& request) override {
    ViewSetup setup =
        MakeViewSetup(request.view, request.bodies, request.freeze_foreground, state_.gaussians.sh_degree);
    setup.selection = SelectionOf(request);
    setup.hard_map = request.hard_foreground;
    const bool foreground = request.foreground || request.hard_foreground;
    const ThreadPool::StopWhen stop(&threads_, request.stop_requested);
    view_.Prepare(request.view.width, request.view.height, request.geometry, foreground, false, &threads_);
    Forward(setup, request.geometry, foreground, nullptr, 0);
    return Collect(request, foreground);
  }

  void Step(const TrainStep& step) override {
    S2GS_INVARIANT(step.photo >= 0 && step.photo < static_cast<int>(photos_.size()));
    const TrainingPhoto& photo = photos_[step.photo];
    state_.gaussians.sh_degree = step.sh_degree;
    const ViewSetup setup = MakeViewSetup(photo.view, step.bodies, step.freeze_foreground, step.sh_degree);
    const bool geometry = step.weights.normal > 0 || step.weights.distortion > 0;
    const bool learns_p = step.bodies == SceneBodies::kBoth && !step.freeze_foreground;
    const bool has_hint = step.weights.mask > 0 && !photo.mask.empty();
    const bool foreground = learns_p && (step.weights.entropy_2d > 0 || has_hint);
    view_.Prepare(photo.view.width, photo.view.height, geometry, foreground, true, &threads_);
    S2GS_INVARIANT(!step.only_rotating_tiles || !learns_p);
    Forward(setup, geometry, foreground, nullptr, sizeof(SplatGradient), step.only_rotating_tiles);

    LossTerms terms;
    CompareToPhoto(step, photo, &terms);
    CompareMaps(step, photo, foreground, &terms);
    Backward(step, setup, geometry, foreground);
    d_logit_.clear();
    if (learns_p && (step.weights.local_consistency > 0 || step.weights.entropy_3d > 0)) {
      const ForegroundTerms p_terms =
          RegulariseForeground(state_.gaussians.foreground_logit, state_.neighbours, state_.num_neighbours,
                               step.weights, &threads_, &d_logit_);
      terms.local_consistency = p_terms.local_consistency;
      terms.entropy_3d = p_terms.entropy_3d;
    }
    UpdateGaussians(step, setup);
    AddLoss(step.weights, terms);
  }

  LossTerms TakeLoss() override {
    LossTerms mean = std::exchange(loss_, {});
    if (mean.steps == 0) return mean;
    const auto steps = static_cast<double>(mean.steps);
    for (double* term : {&mean.total, &mean.l1, &mean.dssim, &mean.normal, &mean.distortion,
                         &mean.local_consistency, &mean.entropy_3d, &mean.entropy_2d, &mean.mask}) {
      *term /= steps;
    }
    return mean;
  }

  DensifyResult Densify(const DensifyStep& step) override {
    const DensifyResult result = DensifyState(step, &state_);
    const int k = state_.num_neighbours;
    if (k > 0) RefreshNeighbours(k);
    return result;
  }

  void ResetOpacity(float max_opacity) override {
    const float max_logit = std::log(max_opacity / (1 - max_opacity));
    for (float& logit : state_.gaussians.opacity_logit) logit = std::min(logit, max_logit);
    std::fill(state_.first_moment.opacity_logit.begin(), state_.first_moment.opacity_logit.end(), 0.0F);
    std::fill(state_.second_moment.opacity_logit.begin(), state_.second_moment.opacity_logit.end(), 0.0F);
  }

  std::vector<float> PeakWeights(const std::vector<PinholeView>& views, SceneBodies bodies,
                                 DrawnBody drawn) override {
    std::vector<float> peaks(state_.gaussians.size(), 0.0F);
    for (const PinholeView& view : views) RaisePeaks(view, bodies, drawn, &peaks);
    return peaks;
  }

  BodySight SeeBody(const PinholeView& view, DrawnBody drawn, float min_weight) override {
    std::vector<float> peaks(state_.gaussians.size(), 0.0F);
    RaisePeaks(view, SceneBodies::kBoth, drawn, &peaks);
    BodySight sight;
    sight.is_seen.reserve(peaks.size());
    for (const float peak : peaks) sight.is_seen.push_back(peak >= min_weight ? 1 : 0);
    const ViewPlanes& planes = view_.planes();
    sight.alpha.reserve(static_cast<size_t>(view.width) * view.height);
    for (int y = 0; y < view.height; ++y) {
      const float* row = planes.transmittance + y * planes.stride;
      for (int x = 0; x < view.width; ++x) sight.alpha.push_back(1 - row[x]);
    }
    return sight;
  }

  void RefreshNeighbours(int k) override {
    std::vector<float> centres = state_.gaussians.centre;
    for (float& value : centres) value = std::isfinite(value) ? value : 0.0F;
    Neighbours found = FindNeighbours(centres, k, threads_.num_threads());
    state_.num_neighbours = found.k;
    state_.neighbours = std::move(found.index);
  }

 private:
  // Draws one body of a view; raises each Gaussian's peak to its largest weight there.
  void RaisePeaks(const PinholeView& view, SceneBodies bodies, DrawnBody drawn, std::vector<float>* peaks) {
    ViewSetup setup = MakeViewSetup(view, bodies, true, 0);
    setup.selection.body = drawn;
    view_.Prepare(view.width, view.height, false, false, false, &threads_);
    std::vector<float> by_slot;
    Forward(setup, false, false, &by_slot, sizeof(float));
    for (size_t i = 0; i < peaks->size(); ++i) {
      for (size_t slot = lists_.SlotBegin(i); slot < lists_.SlotBegin(i + 1); ++slot) {
        (*peaks)[i] = std::max((*peaks)[i], by_slot[slot]);
      }
    }
  }

  // Projects, sorts and composites. \param peaks  when given, gets the largest weight of every slot.
  // \param bytes_per_slot  of gradients or peaks that are kept for every slot.
  // \param only_rotating_tiles  TrainStep's.
  void Forward(const ViewSetup& setup, bool geometry, bool foreground, std::vector<float>* peaks,
               size_t bytes_per_slot, bool only_rotating_tiles = false) {
    const auto count = static_cast<int64_t>(state_.gaussians.size());
    rows_.resize(state_.gaussians.size());
    threads_.For(count, [&](int64_t begin, int64_t end) {
      for (int64_t i = begin; i < end; ++i) ProjectGaussian(state_.gaussians, i, setup, &rows_[i]);
    });
    is_rotating_.clear();
    for (int64_t i = 0; i < count && only_rotating_tiles; ++i)
      is_rotating_.push_back(IsForeground(state_.gaussians.foreground_logit[i], setup.rule) ? 1 : 0);
    lists_.Build(rows_, setup.camera.width, setup.camera.height, &threads_, bytes_per_slot,
                 only_rotating_tiles ? &is_rotating_ : nullptr);
    if (peaks != nullptr) peaks->assign(lists_.num_slots(), 0.0F);
    near_depth_ = setup.camera.near_depth;
    threads_.For(lists_.num_tiles(), 1, [&](int64_t tile, int64_t) {
      TileJob job = JobOf(static_cast<int>(tile));
      job.peak_by_slot = peaks != nullptr ? peaks->data() : nullptr;
      kernels_.forward(job, geometry, foreground);
    });
  }

  TileJob JobOf(int tile) {
    TileJob job{};
    job.splats = rows_.data();
    job.entries = lists_.Entries(tile).data();
    job.num_entries = static_cast<int32_t>(lists_.Entries(tile).size());
    job.x0 = tile % lists_.tiles_x() * kTileSize;
    job.y0 = tile / lists_.tiles_x() * kTileSize;
    job.near_depth = near_depth_;
    job.planes = view_.planes();
    job.gradients = view_.gradients();
    return job;
  }

  RenderedView Collect(const RenderRequest& request, bool foreground) {
    RenderedView out;
    out.width = request.view.width;
    out.height = request.view.height;
    const auto count = static_cast<size_t>(out.width) * out.height;
    const auto make = [&](size_t size, std::vector<float>* map) {
      threads_.ThrowIfStopped();
      map->resize(size);
    };
    make(3 * count, &out.color);
    make(count, &out.alpha);
    if (foreground) make(count, &out.foreground);
    if (request.geometry) {
      make(count, &out.expected_depth);
      make(count, &out.median_depth);
      make(3 * count, &out.normal);
      make(count, &out.distortion);
    }
    threads_.For(out.height, 1, [&](int64_t y, int64_t) { CollectRow(request, foreground, y, &out); });
    return out;
  }

  void CollectRow(const RenderRequest& request, bool foreground, int64_t y, RenderedView* out) const {
    const ViewPlanes& planes = view_.planes();
    for (int x = 0; x < out->width; ++x) {
      const size_t from = y * planes.stride + x;
      const size_t to = static_cast<size_t>(y) * out->width + x;
      const float transmittance = planes.transmittance[from];
      out->alpha[to] = 1 - transmittance;
      for (int c = 0; c < 3; ++c) {
        out->color[3 * to + c] = planes.color[c][from] + transmittance * request.background_color[c];
      }
      if (foreground) out->foreground[to] = planes.foreground[from];
      if (!request.geometry) continue;
      const float weight = planes.weight[from];
      out->expected_depth[to] = weight > 0 ? planes.depth[from] / weight : 0;
      out->median_depth[to] = planes.median[from];
      out->distortion[to] = planes.distortion[from];
      for (int c = 0; c < 3; ++c) out->normal[3 * to + c] = planes.normal[c][from];
    }
  }

  // One channel of one row, rendered and real, as it is compared.
  void SetPhotoRow(const TrainStep& step, const TrainingPhoto& photo, int y, int c) {
    const int width = photo.view.width;
    const ViewPlanes& planes = view_.planes();
    float* image = view_.image(c) + y * planes.stride;
    float* real = view_.photo(c) + y * planes.stride;
    const float* color = planes.color[c] + y * planes.stride;
    const float* transmittance = planes.transmittance + y * planes.stride;
    const uint8_t* bytes = photo.image.Pixel(0, y) + c;
    for (int x = 0; x < width; ++x) {
      image[x] = color[x] + transmittance[x] * step.background_color[c];
      real[x] = static_cast<float>(bytes[3 * x]) * (1.0F / 255);
    }
    if (step.cut_out_mask && !photo.mask.empty()) {
      const uint8_t* mask = photo.mask.data() + static_cast<size_t>(y) * width;
      for (int x = 0; x < width; ++x) {
        if (mask[x] < 128) real[x] = step.background_color[c];
      }
    }
    if (!step.only_rotating_tiles) return;
    for (int x = 0; x < width; ++x) {
      if (!lists_.IsListed(y / kTileSize * lists_.tiles_x() + x / kTileSize)) image[x] = real[x];
    }
  }

  // L1 and D-SSIM, and the loss by the colour.
  void CompareToPhoto(const TrainStep& step, const TrainingPhoto& photo, LossTerms* terms) {
    const int width = photo.view.width;
    const int height = photo.view.height;
    const ViewPlanes& planes = view_.planes();
    threads_.For(3 * int64_t{height}, [&](int64_t begin, int64_t end) {
      for (int64_t row = begin; row < end; ++row)
        SetPhotoRow(step, photo, static_cast<int>(row / 3), static_cast<int>(row % 3));
    });
    const double num_values = 3.0 * width * height;
    std::vector<double> l1_rows(3 * static_cast<size_t>(height), 0);
    std::vector<double> ssim_rows(3 * static_cast<size_t>(height), 0);
    std::array<PhotoLossJob, 3> jobs{};
    for (int c = 0; c < 3; ++c) {
      PhotoLossJob& job = jobs[c];
      job.width = width;
      job.height = height;
      job.stride = planes.stride;
      job.rendered = view_.image(c);
      job.photo = view_.photo(c);
      for (int i = 0; i < 5; ++i) job.scratch[i] = view_.scratch(7 * c + i);
      job.by_square = view_.scratch(7 * c + 5);
      job.by_product = view_.scratch(7 * c + 6);
      job.d_rendered = view_.gradients().color[c];
      job.l1_weight = static_cast<float>((1 - step.weights.dssim) / num_values);
      job.ssim_weight = static_cast<float>(-step.weights.dssim / num_values);
      job.l1_rows = l1_rows.data() + static_cast<size_t>(c) * height;
      job.ssim_rows = ssim_rows.data() + static_cast<size_t>(c) * height;
    }
    constexpr int kRowsAtOnce = 8;
    const int blocks = (height + kRowsAtOnce - 1) / kRowsAtOnce;
    for (int pass = 0; pass < 4; ++pass) {
      threads_.For(int64_t{3} * blocks, [&](int64_t begin, int64_t end) {
        for (int64_t i = begin; i < end; ++i) {
          const int y = static_cast<int>(i % blocks) * kRowsAtOnce;
          kernels_.photo_loss(jobs[i / blocks], pass, y, std::min(height, y + kRowsAtOnce));
        }
      });
    }
    for (const double sum : l1_rows) terms->l1 += sum / num_values;
    for (const double sum : ssim_rows) terms->dssim += sum / num_values;
    terms->dssim = 1 - terms->dssim;
  }

  void CompareMaps(const TrainStep& step, const TrainingPhoto& photo, bool foreground, LossTerms* terms) {
    ViewMaps maps;
    const ViewPlanes& planes = view_.planes();
    const ViewGradients& gradients = view_.gradients();
    maps.view = &photo.view;
    maps.stride = planes.stride;
    maps.transmittance = planes.transmittance;
    maps.foreground = planes.foreground;
    maps.weight = planes.weight;
    maps.depth = planes.depth;
    maps.distortion = planes.distortion;
    maps.d_alpha = gradients.alpha;
    maps.d_foreground = gradients.foreground;
    maps.d_expected_depth = gradients.expected_depth;
    maps.d_distortion = gradients.distortion;
    for (int c = 0; c < 3; ++c) {
      maps.normal[c] = planes.normal[c];
      maps.d_normal[c] = gradients.normal[c];
    }
    if (foreground && !photo.mask.empty()) maps.mask = photo.mask.data();
    const ViewLossTerms view_terms = RegulariseView(maps, step.weights, &threads_);
    terms->normal = view_terms.normal;
    terms->distortion = view_terms.distortion;
    terms->entropy_2d = view_terms.entropy_2d;
    terms->mask = view_terms.mask;
  }

  void Backward(const TrainStep& step, const ViewSetup& setup, bool geometry, bool foreground) {
    near_depth_ = setup.camera.near_depth;
    by_slot_.resize(lists_.num_slots());
    threads_.For(lists_.num_tiles(), 1, [&](int64_t tile, int64_t) {
      TileJob job = JobOf(static_cast<int>(tile));
      for (int c = 0; c < 3; ++c) job.background[c] = step.background_color[c];
      job.by_slot = by_slot_.data();
      kernels_.backward(job, geometry, foreground);
    });
  }

  // Sums each Gaussian's gradient over its tiles, takes it to the parameters and moves them.
  void UpdateGaussians(const TrainStep& step, const ViewSetup& setup) {
    const AdamStep<float> adam = MakeAdamStep<float>(step.iteration);
    const auto count = static_cast<int64_t>(state_.gaussians.size());
    const int64_t num_chunks = (count + kChunk - 1) / kChunk;
    const float to_ndc_x = 0.5F * static_cast<float>(setup.camera.width);
    const float to_ndc_y = 0.5F * static_cast<float>(setup.camera.height);
    threads_.For(num_chunks, [&](int64_t first_chunk, int64_t last_chunk) {
      GaussianGradients gradients;
      gradients.Resize(kChunk);
      for (int64_t chunk = first_chunk; chunk < last_chunk; ++chunk) {
        const int64_t begin = chunk * kChunk;
        const int64_t end = std::min(count, begin + kChunk);
        gradients.SetZero();
        for (int64_t i = begin; i < end; ++i) {
          if (lists_.SlotBegin(i) == lists_.SlotBegin(i + 1)) continue;
          const SplatGradient sum = SumSlots(i);
          ProjectGaussianAdjoint(state_.gaussians, i, setup, rows_[i], sum, i - begin, &gradients);
          if (!step.collect_statistics) continue;
          state_.gradient_sum[i] += std::hypot(sum.x * to_ndc_x, sum.y * to_ndc_y);
          state_.view_count[i] += 1;
        }
        if (!d_logit_.empty()) {
          for (int64_t i = begin; i < end; ++i) gradients.foreground_logit[i - begin] += d_logit_[i];
        }
        if (!step.only_rotating_tiles) {
          Update(adam, step, begin, end - begin, 0, gradients);
          continue;
        }
        for (int64_t i = begin; i < end;) {
          const int64_t first = i;
          while (i < end && lists_.SlotBegin(i) < lists_.SlotBegin(i + 1)) ++i;
          if (i > first) Update(adam, step, first, i - first, first - begin, gradients);
          while (i < end && lists_.SlotBegin(i) == lists_.SlotBegin(i + 1)) ++i;
        }
      }
    });
  }

  SplatGradient SumSlots(size_t i) const {
    SplatGradient sum = {};
    static_assert(sizeof(SplatGradient) == kSplatGradientFloats * sizeof(float), "summed as an array");
    auto* out = reinterpret_cast<float*>(&sum);
    for (size_t slot = lists_.SlotBegin(i); slot < lists_.SlotBegin(i + 1); ++slot) {
      const auto* in = reinterpret_cast<const float*>(&by_slot_[slot]);
      for (int j = 0; j < kSplatGradientFloats; ++j) out[j] += in[j];
    }
    return sum;
  }

  // Moves `count` Gaussians from `begin` on, whose gradients stand from `from` on.
  void Update(const AdamStep<float>& adam, const TrainStep& step, size_t begin, size_t count, size_t from,
              const GaussianGradients& gradients) {
    const auto update = [&](float rate, const std::vector<float>& gradient, size_t width,
                            std::vector<float> Gaussians::*field) {
      const size_t at = width * begin;
      kernels_.adam(rate, adam.first_correction, adam.second_correction, gradient.data() + width * from,
                    width * count, (state_.gaussians.*field).data() + at,
                    (state_.first_moment.*field).data() + at, (state_.second_moment.*field).data() + at);
    };
    update(step.rates.centre, gradients.centre, 3, &Gaussians::centre);
    update(step.rates.log_scale, gradients.log_scale, 2, &Gaussians::log_scale);
    update(step.rates.rotation, gradients.rotation, 4, &Gaussians::rotation);
    update(step.rates.opacity, gradients.opacity_logit, 1, &Gaussians::opacity_logit);
    update(step.rates.sh_dc, gradients.sh_dc, 3, &Gaussians::sh_dc);
    // Bands that are not in use have no gradient and no moments.
    if (step.sh_degree > 0) {
      update(step.rates.sh_rest, gradients.sh_rest, static_cast<size_t>(3) * kShRestPerChannel,
             &Gaussians::sh_rest);
    }
    if (step.bodies == SceneBodies::kBoth && !step.freeze_foreground) {
      update(step.rates.foreground, gradients.foreground_logit, 1, &Gaussians::foreground_logit);
    }
  }

  void AddLoss(const LossWeights& w, const LossTerms& terms) {
    ++loss_.steps;
    loss_.l1 += terms.l1;
    loss_.dssim += terms.dssim;
    loss_.normal += terms.normal;
    loss_.distortion += terms.distortion;
    loss_.local_consistency += terms.local_consistency;
    loss_.entropy_3d += terms.entropy_3d;
    loss_.entropy_2d += terms.entropy_2d;
    loss_.mask += terms.mask;
    loss_.total += (1 - w.dssim) * terms.l1 + w.dssim * terms.dssim + w.normal * terms.normal +
                   w.distortion * terms.distortion + w.local_consistency * terms.local_consistency +
                   w.entropy_3d * terms.entropy_3d + w.entropy_2d * terms.entropy_2d + w.mask * terms.mask;
  }

  ThreadPool threads_;
  const TileKernels& kernels_;
  std::vector<TrainingPhoto> photos_;
  TrainState state_;
  LossTerms loss_;

  // Of the view at hand.
  ViewBuffers view_;
  std::vector<SplatRow> rows_;
  std::vector<uint8_t> is_rotating_;  // by row, where only their tiles are drawn
  TileLists lists_;
  std::vector<SplatGradient> by_slot_;
  std::vector<float> d_logit_;
  float near_depth_ = 0;
};

}  // namespace

std::unique_ptr<Backend> MakeCpuBackend(int num_threads) { return std::make_unique<CpuBackend>(num_threads); }

}  // namespace s2gs
