#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include "s2gs/backend/backend.h"
#include "s2gs/backend/splat_camera.h"
#include "s2gs/core/cuda.h"
#include "s2gs/core/gpu_info.h"
#include "s2gs/cuda/bin.h"
#include "s2gs/cuda/colors.h"
#include "s2gs/cuda/device_model.h"
#include "s2gs/cuda/device_photos.h"
#include "s2gs/cuda/losses.h"
#include "s2gs/cuda/model_transfer.h"
#include "s2gs/cuda/optimise.h"
#include "s2gs/cuda/project.h"
#include "s2gs/cuda/render.h"
#include "s2gs/cuda/step_reports.h"
#include "s2gs/cuda/streams.h"
#include "s2gs/cuda/view_download.h"
#include "s2gs/cuda/view_maps.h"

// All work goes to one stream, in order, but for the colours' bands 1 to 3, three quarters of the model's
// numbers: a step leaves their update to the next ones, which make it together with the new view's colours on
// a stream beside, while its splats are projected and sorted. Memory is the bound of the one and not of the
// other. Each writes a part of the model back (ColorLog), and whatever else looks at the model has all of it
// written first (FinishColors()). The losses of the maps and of the model go beside those of the colours,
// too.
//
// Step() never waits for the GPU: how many pairs of a splat and a tile a view will have is not known when its
// sort is launched, so each step sorts as many as recent steps had and a margin. The GPU compares, and a step
// with more pairs than room leaves the model and the losses as they are; its count comes back a few steps
// later and makes the room larger. In training that happens when growth outruns the margin, to a few steps in
// ten thousand. Rendering waits for its count and is always complete.

namespace s2gs {
namespace {

using namespace cuda;  // NOLINT(google-build-using-namespace): this file is the other half of that namespace.

// Per step.
LossTerms MeanOf(const LossSums& sums) {
  LossTerms terms;
  terms.steps = static_cast<int64_t>(sums.steps);
  if (terms.steps == 0) return terms;
  terms.l1 = sums.l1 / sums.steps;
  terms.dssim = sums.dssim / sums.steps;
  terms.normal = sums.normal / sums.steps;
  terms.distortion = sums.distortion / sums.steps;
  terms.local_consistency = sums.local_consistency / sums.steps;
  terms.entropy_3d = sums.entropy_3d / sums.steps;
  terms.entropy_2d = sums.entropy_2d / sums.steps;
  terms.mask = sums.mask / sums.steps;
  terms.total = sums.total / sums.steps;
  return terms;
}

class CudaBackend : public Backend {
 public:
  explicit CudaBackend(int gpu_index) {
    cudaDeviceProp properties;
    CheckCuda(cudaGetDeviceProperties(&properties, gpu_index), "cudaGetDeviceProperties");
    device_name_ = properties.name;
    num_processors_ = properties.multiProcessorCount;
    is_skipped_.Reserve(kColorLogSize);
    sums_.Reserve(1);
    CheckCuda(cudaMemsetAsync(sums_.get(), 0, sizeof(LossSums), stream_), "losses");
  }

  ~CudaBackend() override {
    streams_.Synchronize();  // before buffers go
  }

  BackendInfo Info() const override {
    BackendInfo info;
    info.kind = BackendKind::kCuda;
    info.device = device_name_;
    info.memory_bytes = memory_.bytes;
    info.peak_memory_bytes = memory_.peak_bytes;
    size_t free_bytes = 0;
    size_t all_bytes = 0;
    CheckCuda(cudaMemGetInfo(&free_bytes, &all_bytes), "cudaMemGetInfo");
    info.free_device_bytes = static_cast<int64_t>(free_bytes);
    return info;
  }

  void SetPhotos(std::vector<TrainingPhoto> photos) override {
    Wait();
    photos_.Set(photos, stream_);
    reports_.Forget();  // other sizes have other counts
  }

  void SetState(const TrainState& state) override {
    Wait();
    color_log_.WroteAll();
    model_.SetState(state);
    ReserveStepBuffers();
    reports_.Forget();
  }

  TrainState GetState() const override {
    FinishColors();
    return model_.GetState();
  }

  Gaussians GetGaussians() const override {
    FinishColors();
    return model_.GetGaussians();
  }
  int64_t Count() const override { return model_.count(); }

  Placement GetPlacement() const override { return model_.GetPlacement(); }

  void Keep(const std::vector<uint32_t>& indices) override {
    FinishColors();
    model_.Keep(indices);
  }

  void SetForegroundLogits(const std::vector<float>& logits) override {
    const auto n = static_cast<size_t>(model_.count());
    S2GS_INVARIANT(logits.size() == n);
    if (n == 0) return;
    CheckCuda(
        cudaMemcpyAsync(d_logits_.get(), logits.data(), n * sizeof(float), cudaMemcpyHostToDevice, stream_),
        "foreground");
    ReplaceForeground(d_logits_.get(), model_.parameters(), model_.first_moments(), model_.second_moments(),
                      model_.count(), stream_);
    Wait();
  }

  RenderedView Render(const RenderRequest& request) override {
    ProjectOptions options;
    options.camera = ToSplatCamera(request.view);
    options.rule = RuleFor(request.bodies, request.freeze_foreground);
    options.selection = SelectionOf(request);
    options.hard_map = request.hard_foreground;
    options.sh_degree = model_.sh_degree();
    const RenderChannels channels = {request.geometry, request.foreground || request.hard_foreground,
                                     request.geometry};
    const RenderInput input = PrepareToDraw(options);
    const Maps maps = maps_.Reserve(request.view.width, request.view.height, channels);
    RenderForward(input, channels, maps, {}, stream_);

    return DownloadView(request, channels, maps, stream_);
  }

  void Step(const TrainStep& step) override {
    S2GS_INVARIANT(step.photo >= 0 && static_cast<size_t>(step.photo) < photos_.size());
    if (model_.count() == 0) return;
    const DevicePhotos::Photo& photo = photos_[step.photo];
    const int width = photo.view.width, height = photo.view.height;
    const LossWeights& weights = step.weights;
    model_.set_sh_degree(step.sh_degree);

    OptimiseInput optimise;
    optimise.view.camera = ToSplatCamera(photo.view);
    optimise.view.rule = RuleFor(step.bodies, step.freeze_foreground);
    optimise.view.sh_degree = step.sh_degree;
    optimise.learns_foreground = optimise.view.rule == ForegroundRule::kSoft;
    S2GS_INVARIANT(!step.only_rotating_tiles || !optimise.learns_foreground);
    const bool has_mask_loss = weights.mask != 0 && photo.device.mask != nullptr;
    const RenderChannels channels = {weights.normal != 0 || weights.distortion != 0,
                                     optimise.learns_foreground && (weights.entropy_2d != 0 || has_mask_loss),
                                     weights.distortion != 0};

    ImageLossInput loss = LossOf(step, photo.device, optimise.view.camera);
    const RenderInput input = ListSplats(step, optimise.view, &loss.is_listed);
    const Maps maps = maps_.Reserve(width, height, channels);
    const HitLists hit_lists = ReserveHits(width, height);
    CheckCuda(cudaStreamWaitEvent(stream_, streams_.colors_drawn), "colours");
    RenderForward(input, channels, maps, hit_lists, stream_);

    const MapGradients d_maps = maps_.ReserveGradients(width, height, channels);
    Streams::HandOver(stream_, streams_.maps_drawn, side_stream_);
    MapLoss(loss, channels.geometry, channels.foreground, maps, d_maps, sums_.get(), side_stream_);
    CheckCuda(cudaEventRecord(streams_.maps_judged, side_stream_), "streams");
    ColorLoss(loss, maps, d_maps, maps_.partials(), sums_.get(), stream_);
    if (optimise.learns_foreground) optimise.d_logits = LossOfModel(weights);
    CheckCuda(cudaStreamWaitEvent(stream_, streams_.maps_judged), "streams");
    RenderBackward(input, channels, maps, hit_lists, d_maps, loss.background, d_splats_.get(),
                   d_normal_z_.get(), stream_);
    Streams::HandOver(side_stream_, streams_.model_judged, stream_);

    optimise.splats = input.splats;
    optimise.has_geometry = channels.geometry;
    Learn(step, optimise);
  }

  void Wait() const override { CheckCuda(cudaStreamSynchronize(stream_), "computation"); }

  LossTerms TakeLoss() override {
    LossSums sums;
    CheckCuda(cudaMemcpyAsync(&sums, sums_.get(), sizeof(sums), cudaMemcpyDeviceToHost, stream_), "losses");
    CheckCuda(cudaMemsetAsync(sums_.get(), 0, sizeof(LossSums), stream_), "losses");
    Wait();
    return MeanOf(sums);
  }

  DensifyResult Densify(const DensifyStep& step) override {
    if (model_.count() == 0) return {};
    FinishColors();
    const int64_t old_count = model_.count();
    const DensifyResult result = model_.Densify(step);
    ReserveStepBuffers();
    if (result.count > old_count) {
      reports_.ExpectGrowth(static_cast<double>(result.count) / static_cast<double>(old_count), &sorter_);
    }
    return result;
  }

  void ResetOpacity(float max_opacity) override {
    if (model_.count() == 0) return;
    const float max_logit = std::log(max_opacity / (1 - max_opacity));
    ClampOpacity(model_.parameters(), model_.first_moments(), model_.second_moments(), model_.count(),
                 max_logit, stream_);
  }

  std::vector<float> PeakWeights(const std::vector<PinholeView>& views, SceneBodies bodies,
                                 DrawnBody drawn) override {
    if (model_.count() == 0) return {};
    ClearPeaks();
    for (const PinholeView& view : views) RaisePeaks(view, bodies, drawn, nullptr);
    return DownloadArray(peak_weights_.get(), static_cast<size_t>(model_.count()), stream_);
  }

  BodySight SeeBody(const PinholeView& view, DrawnBody drawn, float min_weight) override {
    if (model_.count() == 0) return {};
    const auto n = static_cast<size_t>(model_.count());
    const size_t size = static_cast<size_t>(view.width) * view.height;
    is_seen_.Reserve(n);
    ClearPeaks();
    const Maps maps = maps_.Reserve(view.width, view.height, {});
    RaisePeaks(view, SceneBodies::kBoth, drawn, maps.transmittance);
    MarkSeen(peak_weights_.get(), model_.count(), min_weight, is_seen_.get(), stream_);
    BodySight sight;
    sight.is_seen = DownloadArray(is_seen_.get(), n, stream_);
    sight.alpha = DownloadArray(maps.transmittance, size, stream_);
    return sight;
  }

  void RefreshNeighbours(int k) override { model_.RefreshNeighbours(k); }

 private:
  // --- A step ---
  // Draws the colours beside the projection and the sort. colors_drawn follows.
  // \param is_listed  gets which tiles are; null: all.
  RenderInput ListSplats(const TrainStep& step, const ProjectOptions& view, const uint8_t** is_listed) {
    const int64_t count = model_.count();
    const int width = view.camera.width, height = view.camera.height;
    reports_.Read(&sorter_);
    sorter_.Reserve(count, width, height);
    if (color_log_.sh_degree() != step.sh_degree) FinishColors();
    Streams::HandOver(stream_, streams_.step_begins, side_stream_);
    DrawColors(color_input(), color_log_.updates(), view, sorter_.splats().splats, color_traits_.get(),
               side_stream_);
    color_log_.WroteOne();
    CheckCuda(cudaEventRecord(streams_.colors_drawn, side_stream_), "colours");
    Project(model_.parameters(), count, view, sorter_.splats(), stream_);
    *is_listed = step.only_rotating_tiles ? sorter_.ListTilesOf(model_.parameters().At(kForeground),
                                                                view.rule, count, width, height, stream_)
                                          : nullptr;
    sorter_.SortByDepth(count, stream_);
    if (reports_.room() == 0) {
      sorter_.ReportTotal(count, reports_.report(), stream_);
      reports_.MakeRoom(reports_.Count(stream_), &sorter_);
    }
    const RenderInput input = {
        sorter_.splats(),
        sorter_.SortByTile(count, width, height, reports_.room(), reports_.report(), stream_, *is_listed),
        width, height, view.camera.near_depth};
    reports_.Send(stream_);
    return input;
  }

  ImageLossInput LossOf(const TrainStep& step, const DevicePhoto& photo,
                        const SplatCamera<float>& camera) const {
    ImageLossInput loss;
    loss.photo = photo;
    loss.background = {step.background_color[0], step.background_color[1], step.background_color[2]};
    loss.cut_out_mask = step.cut_out_mask;
    loss.weights = step.weights;
    loss.fx = camera.fx;
    loss.fy = camera.fy;
    loss.cx = camera.cx;
    loss.cy = camera.cy;
    loss.report = reports_.report();
    return loss;
  }

  // The loss by the foreground logits beside the photo's; null: none.
  const float* LossOfModel(const LossWeights& weights) {
    const bool has_neighbours = model_.num_neighbours() > 0 && weights.local_consistency != 0;
    if (!has_neighbours && weights.entropy_3d == 0) return nullptr;
    const ModelLossInput loss = {model_.parameters().At(kForeground),
                                 static_cast<int>(model_.count()),
                                 model_.neighbours(),
                                 model_.num_neighbours(),
                                 has_neighbours ? weights.local_consistency : 0,
                                 weights.entropy_3d,
                                 reports_.report()};
    ModelLoss(loss, d_logits_.get(), sums_.get(), side_stream_);
    return d_logits_.get();
  }

  // \param optimise  knows the view, its splats and channels, and the loss by the logits.
  void Learn(const TrainStep& step, OptimiseInput optimise) {
    optimise.parameters = model_.parameters();
    optimise.first_moments = model_.first_moments();
    optimise.second_moments = model_.second_moments();
    optimise.count = static_cast<int>(model_.count());
    optimise.d_splats = d_splats_.get();
    optimise.d_normal_z = d_normal_z_.get();
    optimise.scratch = {scratch_.get(), model_.stride()};
    optimise.color_traits = color_traits_.get();
    optimise.color_slot = color_log_.next_slot();
    optimise.is_skipped = is_skipped_.get();
    optimise.only_drawn = step.only_rotating_tiles;
    optimise.adam = MakeAdamStep<float>(step.iteration);
    optimise.rates = step.rates;
    if (step.collect_statistics) {
      optimise.gradient_sum = model_.gradient_sum();
      optimise.view_count = model_.view_count();
    }
    optimise.report = reports_.report();
    optimise.sums = sums_.get();
    Optimise(optimise, stream_);
    if (step.sh_degree > 0) {
      color_log_.Add({optimise.adam, step.rates.sh_rest, optimise.color_slot,
                      step.only_rotating_tiles ? sorter_.splats().tile_counts : nullptr},
                     step.sh_degree);
    }
    // The next projection counts tiles anew.
    if (step.only_rotating_tiles) FinishColors();
  }

  // --- Colours ---
  ColorInput color_input() const {
    return {model_.parameters(),     model_.first_moments(),
            model_.second_moments(), {scratch_.get(), model_.stride()},
            is_skipped_.get(),       model_.count(),
            num_processors_};
  }

  // Makes the updates that steps left to the next ones.
  void FinishColors() const {
    LearnColors(color_input(), color_log_.updates(), stream_);
    color_log_.WroteAll();
  }

  // --- Memory ---
  // Arrays of one row per Gaussian besides the model.
  void ReserveStepBuffers() {
    const size_t rows = model_.stride();
    if (d_splats_.capacity() < rows * kPackedFloats) {
      d_splats_.Reserve(rows * kPackedFloats);
      d_normal_z_.Reserve(rows);
      // The optimiser leaves zeros behind; what is new must begin with them.
      CheckCuda(cudaMemsetAsync(d_splats_.get(), 0, sizeof(float) * rows * kPackedFloats, stream_),
                "gradients");
      CheckCuda(cudaMemsetAsync(d_normal_z_.get(), 0, sizeof(float) * rows, stream_), "gradients");
    }
    d_logits_.Reserve(rows);
    scratch_.Reserve(kNumScratchPlanes * rows);
    color_traits_.Reserve(rows);
    sorter_.Reserve(static_cast<int64_t>(rows), 1, 1);
  }

  // --- What is seen ---
  void ClearPeaks() {
    peak_weights_.Reserve(static_cast<size_t>(model_.count()));
    CheckCuda(
        cudaMemsetAsync(peak_weights_.get(), 0, sizeof(float) * static_cast<size_t>(model_.count()), stream_),
        "peak weights");
  }

  void RaisePeaks(const PinholeView& view, SceneBodies bodies, DrawnBody drawn, float* alpha) {
    ProjectOptions options;
    options.camera = ToSplatCamera(view);
    options.rule = RuleFor(bodies, true);
    options.selection.body = drawn;
    options.sh_degree = 0;
    RenderPeakWeights(PrepareToDraw(options), peak_weights_.get(), alpha, stream_);
  }

  // --- Intersections ---
  RenderInput PrepareToDraw(const ProjectOptions& options) {
    FinishColors();
    const int width = options.camera.width, height = options.camera.height;
    sorter_.Reserve(std::max<int64_t>(model_.count(), 1), width, height);
    int64_t room = 0;
    if (model_.count() > 0) {
      Project(model_.parameters(), model_.count(), options, sorter_.splats(), stream_);
      DrawColors(color_input(), {}, options, sorter_.splats().splats, color_traits_.get(), stream_);
      sorter_.SortByDepth(model_.count(), stream_);
      sorter_.ReportTotal(model_.count(), reports_.report(), stream_);
      room = reports_.Count(stream_);
      sorter_.ReserveIntersections(room);
    }
    return {sorter_.splats(),
            sorter_.SortByTile(model_.count(), width, height, room, reports_.report(), stream_), width,
            height, options.camera.near_depth};
  }

  // For as many pairs of a splat and a tile as there is room for.
  HitLists ReserveHits(int width, int height) {
    const size_t num_tiles = static_cast<size_t>(NumTiles(width)) * static_cast<size_t>(NumTiles(height));
    hits_.Reserve(kTileWarps * static_cast<size_t>(reports_.reserved_room()));
    hit_counts_.Reserve(kTileWarps * num_tiles);
    return {hits_.get(), hit_counts_.get()};
  }

  std::string device_name_;
  int num_processors_ = 0;
  Streams streams_;
  const cudaStream_t stream_ = streams_.main(), side_stream_ = streams_.side();
  DeviceMemoryCount memory_;

  DeviceModel model_{&memory_, stream_};
  DevicePhotos photos_{&memory_};

  TileSorter sorter_{&memory_};
  ViewMaps maps_{&memory_};
  DeviceBuffer<WarpHit> hits_{&memory_};
  DeviceBuffer<uint32_t> hit_counts_{&memory_};
  DeviceBuffer<float> d_splats_{&memory_}, d_normal_z_{&memory_}, d_logits_{&memory_}, scratch_{&memory_},
      peak_weights_{&memory_};
  DeviceBuffer<uint8_t> is_seen_{&memory_}, color_traits_{&memory_};
  mutable ColorLog color_log_;
  DeviceBuffer<uint32_t> is_skipped_{&memory_};  // by slot of the log: that step, for lack of room

  DeviceBuffer<LossSums> sums_{&memory_};
  StepReports reports_{&memory_};
};

}  // namespace

std::unique_ptr<Backend> MakeCudaBackend(int gpu_index) {
  const std::vector<GpuInfo> gpus = ListGpus();
  if (gpus.empty())
    throw UserError("No NVIDIA GPU with a working driver was found. Compute on the CPU instead");
  if (gpu_index < 0 || static_cast<size_t>(gpu_index) >= gpus.size()) {
    throw UserError("There is no GPU " + std::to_string(gpu_index) + ": this machine has " +
                    std::to_string(gpus.size()));
  }
  const GpuInfo& gpu = gpus[static_cast<size_t>(gpu_index)];
  if (!gpu.is_usable)
    throw UserError("GPU " + std::to_string(gpu_index) + " (" + gpu.name + "): " + gpu.problem);
  // Before its members allocate.
  CheckCuda(cudaSetDevice(gpu_index), "cudaSetDevice");
  return std::make_unique<CudaBackend>(gpu_index);
}

}  // namespace s2gs
