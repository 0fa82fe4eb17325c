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
#include "s2gs/cuda/densify.h"
#include "s2gs/cuda/knn.h"
#include "s2gs/cuda/losses.h"
#include "s2gs/cuda/model_transfer.h"
#include "s2gs/cuda/optimise.h"
#include "s2gs/cuda/project.h"
#include "s2gs/cuda/render.h"
#include "s2gs/cuda/step_reports.h"
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

class CudaBackend : public Backend {
 public:
  explicit CudaBackend(int gpu_index) {
    cudaDeviceProp properties;
    CheckCuda(cudaGetDeviceProperties(&properties, gpu_index), "cudaGetDeviceProperties");
    device_name_ = properties.name;
    num_processors_ = properties.multiProcessorCount;
    int least_priority = 0, greatest_priority = 0;
    CheckCuda(cudaDeviceGetStreamPriorityRange(&least_priority, &greatest_priority), "stream priorities");
    CheckCuda(cudaStreamCreateWithPriority(&stream_, cudaStreamNonBlocking, greatest_priority), "streams");
    CheckCuda(cudaStreamCreateWithPriority(&side_stream_, cudaStreamNonBlocking, least_priority), "streams");
    for (cudaEvent_t* event : {&step_begins_, &colors_drawn_, &maps_drawn_, &maps_judged_, &model_judged_}) {
      CheckCuda(cudaEventCreateWithFlags(event, cudaEventDisableTiming), "events");
    }
    is_skipped_.Reserve(kColorLogSize);
    sums_.Reserve(1);
    CheckCuda(cudaMemsetAsync(sums_.get(), 0, sizeof(LossSums), stream_), "losses");
  }

  ~CudaBackend() override {
    cudaStreamSynchronize(side_stream_);
    cudaStreamSynchronize(stream_);
    for (const cudaEvent_t event : {step_begins_, colors_drawn_, maps_drawn_, maps_judged_, model_judged_}) {
      cudaEventDestroy(event);
    }
    cudaStreamDestroy(side_stream_);
    cudaStreamDestroy(stream_);
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
    photos_.clear();
    photos_.reserve(photos.size());
    size_t bytes = 0;
    for (const TrainingPhoto& photo : photos) bytes += photo.image.pixels.size() + photo.mask.size();
    photo_bytes_.Reserve(bytes);
    uint8_t* next = photo_bytes_.get();
    const auto upload = [&](const std::vector<uint8_t>& values) -> const uint8_t* {
      if (values.empty()) return nullptr;
      uint8_t* target = next;
      Upload(values, target, "photos");
      next += values.size();
      return target;
    };
    for (const TrainingPhoto& photo : photos) {
      S2GS_INVARIANT(photo.image.channels == 3 && photo.image.width == photo.view.width &&
                     photo.image.height == photo.view.height);
      const uint8_t* rgb = upload(photo.image.pixels);
      const uint8_t* mask = upload(photo.mask);
      photos_.push_back({photo.view, {rgb, mask, photo.view.width, photo.view.height}});
    }
    Wait();
    reports_.Forget();  // other sizes have other counts
  }

  void SetState(const TrainState& state) override {
    Wait();
    color_log_.WroteAll();
    count_ = static_cast<int64_t>(state.gaussians.size());
    S2GS_INVARIANT(count_ <= std::numeric_limits<int32_t>::max() - 1024);
    sh_degree_ = state.gaussians.sh_degree;
    ReserveModel(count_);
    const auto rows = static_cast<size_t>(count_);
    UploadGaussians(state.gaussians, rows, parameters(), stream_);
    UploadGaussians(state.first_moment, rows, first_moments(), stream_);
    UploadGaussians(state.second_moment, rows, second_moments(), stream_);
    UploadSums(state.gradient_sum, gradient_sum_.get());
    UploadSums(state.view_count, view_count_.get());
    num_neighbours_ = state.num_neighbours;
    if (num_neighbours_ > 0) {
      const auto k = static_cast<size_t>(num_neighbours_);
      const auto n = static_cast<size_t>(count_);
      S2GS_INVARIANT(state.neighbours.size() == k * n);
      std::vector<uint32_t> planes(k * n);
      for (size_t i = 0; i < n; ++i) {
        for (size_t j = 0; j < k; ++j) planes[j * n + i] = state.neighbours[i * k + j];
      }
      neighbours_.Reserve(k * n);
      Upload(planes, neighbours_.get(), "neighbours");
      Wait();
    }
    reports_.Forget();
  }

  TrainState GetState() const override {
    FinishColors();
    TrainState state;
    state.gaussians = DownloadModel(parameters());
    state.first_moment = DownloadModel(first_moments());
    state.second_moment = DownloadModel(second_moments());
    state.gradient_sum = DownloadArray(gradient_sum_.get(), static_cast<size_t>(count_), stream_);
    state.view_count = DownloadArray(view_count_.get(), static_cast<size_t>(count_), stream_);
    state.num_neighbours = num_neighbours_;
    const auto k = static_cast<size_t>(num_neighbours_);
    const auto n = static_cast<size_t>(count_);
    const std::vector<uint32_t> planes = DownloadArray(neighbours_.get(), k * n, stream_);
    state.neighbours.resize(k * n);
    for (size_t i = 0; i < n; ++i) {
      for (size_t j = 0; j < k; ++j) state.neighbours[i * k + j] = planes[j * n + i];
    }
    return state;
  }

  Gaussians GetGaussians() const override {
    FinishColors();
    return DownloadModel(parameters());
  }
  int64_t Count() const override { return count_; }

  Placement GetPlacement() const override {
    const auto n = static_cast<size_t>(count_);
    Placement placement;
    placement.centre.resize(3 * n);
    for (size_t axis = 0; axis < 3; ++axis) {
      const std::vector<float> plane = DownloadArray(model_.get() + (kCentre + axis) * stride_, n, stream_);
      for (size_t i = 0; i < n; ++i) placement.centre[3 * i + axis] = plane[i];
    }
    placement.foreground_logit = DownloadArray(model_.get() + kForeground * stride_, n, stream_);
    return placement;
  }

  void Keep(const std::vector<uint32_t>& indices) override {
    FinishColors();
    const std::vector<float> gradient_sum = Chosen(gradient_sum_.get(), indices);
    const std::vector<float> view_count = Chosen(view_count_.get(), indices);
    DeviceBuffer<uint32_t> sources(&memory_);
    sources.Reserve(std::max<size_t>(1, indices.size()));
    CheckCuda(cudaMemcpyAsync(sources.get(), indices.data(), indices.size() * sizeof(uint32_t),
                              cudaMemcpyHostToDevice, stream_),
              "choice of Gaussians");
    spare_.Reserve(3 * kNumPlanes * stride_);
    GatherModel(sources.get(), nullptr, static_cast<int64_t>(indices.size()), parameters(),
                {spare_.get(), stride_}, stream_);
    Wait();
    model_.Swap(spare_);
    count_ = static_cast<int64_t>(indices.size());
    UploadSums(gradient_sum, gradient_sum_.get());
    UploadSums(view_count, view_count_.get());
    num_neighbours_ = 0;
  }

  void SetForegroundLogits(const std::vector<float>& logits) override {
    const auto n = static_cast<size_t>(count_);
    S2GS_INVARIANT(logits.size() == n);
    if (n == 0) return;
    CheckCuda(
        cudaMemcpyAsync(d_logits_.get(), logits.data(), n * sizeof(float), cudaMemcpyHostToDevice, stream_),
        "foreground");
    ReplaceForeground(d_logits_.get(), parameters(), first_moments(), second_moments(), count_, stream_);
    Wait();
  }

  RenderedView Render(const RenderRequest& request) override {
    ProjectOptions options;
    options.camera = ToSplatCamera(request.view);
    options.rule = RuleFor(request.bodies, request.freeze_foreground);
    options.selection = SelectionOf(request);
    options.hard_map = request.hard_foreground;
    options.sh_degree = sh_degree_;
    const RenderChannels channels = {request.geometry, request.foreground || request.hard_foreground,
                                     request.geometry};
    const RenderInput input = PrepareToDraw(options);
    const Maps maps = maps_.Reserve(request.view.width, request.view.height, channels);
    RenderForward(input, channels, maps, {}, stream_);

    const size_t size = static_cast<size_t>(request.view.width) * request.view.height;
    RenderedView view;
    view.width = request.view.width;
    view.height = request.view.height;
    const std::vector<float> color = DownloadArray(maps.color, 3 * size, stream_);
    view.alpha = DownloadArray(maps.transmittance, size, stream_);
    view.color.resize(3 * size);
    for (size_t i = 0; i < size; ++i) {
      for (size_t c = 0; c < 3; ++c) {
        view.color[3 * i + c] = color[c * size + i] + view.alpha[i] * request.background_color[c];
      }
      view.alpha[i] = 1 - view.alpha[i];
    }
    if (channels.foreground) view.foreground = DownloadArray(maps.foreground, size, stream_);
    if (channels.geometry) {
      const std::vector<float> normal = DownloadArray(maps.normal, 3 * size, stream_);
      const std::vector<float> weight = DownloadArray(maps.weight, size, stream_);
      view.expected_depth = DownloadArray(maps.depth, size, stream_);
      view.median_depth = DownloadArray(maps.median_depth, size, stream_);
      view.distortion = DownloadArray(maps.distortion, size, stream_);
      view.normal.resize(3 * size);
      for (size_t i = 0; i < size; ++i) {
        view.expected_depth[i] = weight[i] > 0 ? view.expected_depth[i] / weight[i] : 0.0F;
        for (size_t c = 0; c < 3; ++c) view.normal[3 * i + c] = normal[c * size + i];
      }
    }
    return view;
  }

  void Step(const TrainStep& step) override {
    S2GS_INVARIANT(step.photo >= 0 && static_cast<size_t>(step.photo) < photos_.size());
    if (count_ == 0) return;
    const Photo& photo = photos_[step.photo];
    const LossWeights& weights = step.weights;
    sh_degree_ = step.sh_degree;

    OptimiseInput optimise;
    optimise.view.camera = ToSplatCamera(photo.view);
    optimise.view.rule = RuleFor(step.bodies, step.freeze_foreground);
    optimise.view.sh_degree = step.sh_degree;
    const bool learns_foreground = optimise.view.rule == ForegroundRule::kSoft;
    const bool has_mask_loss = weights.mask != 0 && photo.device.mask != nullptr;
    const RenderChannels channels = {weights.normal != 0 || weights.distortion != 0,
                                     learns_foreground && (weights.entropy_2d != 0 || has_mask_loss),
                                     weights.distortion != 0};

    reports_.Read(&sorter_);
    sorter_.Reserve(count_, photo.view.width, photo.view.height);
    if (color_log_.sh_degree() != step.sh_degree) FinishColors();
    HandOver(stream_, step_begins_, side_stream_);
    DrawColors(color_input(), color_log_.updates(), optimise.view, sorter_.splats().splats,
               color_traits_.get(), side_stream_);
    color_log_.WroteOne();
    CheckCuda(cudaEventRecord(colors_drawn_, side_stream_), "colours");
    Project(parameters(), count_, optimise.view, sorter_.splats(), stream_);
    S2GS_INVARIANT(!step.only_rotating_tiles || !learns_foreground);
    const uint8_t* is_listed = step.only_rotating_tiles
                                   ? sorter_.ListTilesOf(parameters().At(kForeground), optimise.view.rule,
                                                         count_, photo.view.width, photo.view.height, stream_)
                                   : nullptr;
    sorter_.SortByDepth(count_, stream_);
    if (reports_.room() == 0) {
      sorter_.ReportTotal(count_, reports_.report(), stream_);
      reports_.MakeRoom(reports_.Count(stream_), &sorter_);
    }
    const RenderInput input = {sorter_.splats(),
                               sorter_.SortByTile(count_, photo.view.width, photo.view.height,
                                                  reports_.room(), reports_.report(), stream_, is_listed),
                               photo.view.width, photo.view.height, optimise.view.camera.near_depth};
    reports_.Send(stream_);

    const Maps maps = maps_.Reserve(photo.view.width, photo.view.height, channels);
    const HitLists hit_lists = ReserveHits(photo.view.width, photo.view.height);
    CheckCuda(cudaStreamWaitEvent(stream_, colors_drawn_), "colours");
    RenderForward(input, channels, maps, hit_lists, stream_);

    ImageLossInput loss;
    loss.photo = photo.device;
    loss.background = {step.background_color[0], step.background_color[1], step.background_color[2]};
    loss.cut_out_mask = step.cut_out_mask;
    loss.is_listed = is_listed;
    loss.weights = weights;
    loss.fx = optimise.view.camera.fx;
    loss.fy = optimise.view.camera.fy;
    loss.cx = optimise.view.camera.cx;
    loss.cy = optimise.view.camera.cy;
    loss.report = reports_.report();
    const MapGradients d_maps = maps_.ReserveGradients(photo.view.width, photo.view.height, channels);
    HandOver(stream_, maps_drawn_, side_stream_);
    MapLoss(loss, channels.geometry, channels.foreground, maps, d_maps, sums_.get(), side_stream_);
    CheckCuda(cudaEventRecord(maps_judged_, side_stream_), "streams");
    ColorLoss(loss, maps, d_maps, maps_.partials(), sums_.get(), stream_);
    const bool has_neighbours = num_neighbours_ > 0 && weights.local_consistency != 0;
    if (learns_foreground && (has_neighbours || weights.entropy_3d != 0)) {
      const ModelLossInput model = {parameters().At(kForeground),
                                    static_cast<int>(count_),
                                    neighbours_.get(),
                                    num_neighbours_,
                                    has_neighbours ? weights.local_consistency : 0,
                                    weights.entropy_3d,
                                    reports_.report()};
      ModelLoss(model, d_logits_.get(), sums_.get(), side_stream_);
      optimise.d_logits = d_logits_.get();
    }
    CheckCuda(cudaStreamWaitEvent(stream_, maps_judged_), "streams");
    RenderBackward(input, channels, maps, hit_lists, d_maps, loss.background, d_splats_.get(),
                   d_normal_z_.get(), stream_);
    HandOver(side_stream_, model_judged_, stream_);

    optimise.parameters = parameters();
    optimise.first_moments = first_moments();
    optimise.second_moments = second_moments();
    optimise.count = static_cast<int>(count_);
    optimise.splats = input.splats;
    optimise.d_splats = d_splats_.get();
    optimise.d_normal_z = d_normal_z_.get();
    optimise.scratch = {scratch_.get(), stride_};
    optimise.color_traits = color_traits_.get();
    optimise.color_slot = color_log_.next_slot();
    optimise.is_skipped = is_skipped_.get();
    optimise.has_geometry = channels.geometry;
    optimise.learns_foreground = learns_foreground;
    optimise.only_drawn = step.only_rotating_tiles;
    optimise.adam = MakeAdamStep<float>(step.iteration);
    optimise.rates = step.rates;
    if (step.collect_statistics) {
      optimise.gradient_sum = gradient_sum_.get();
      optimise.view_count = view_count_.get();
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

  void Wait() const override { CheckCuda(cudaStreamSynchronize(stream_), "computation"); }

  LossTerms TakeLoss() override {
    LossSums sums;
    CheckCuda(cudaMemcpyAsync(&sums, sums_.get(), sizeof(sums), cudaMemcpyDeviceToHost, stream_), "losses");
    CheckCuda(cudaMemsetAsync(sums_.get(), 0, sizeof(LossSums), stream_), "losses");
    Wait();
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

  DensifyResult Densify(const DensifyStep& step) override {
    if (count_ == 0) return {};
    FinishColors();
    const DensifyResult result =
        densify_.Make(parameters(), count_, gradient_sum_.get(), view_count_.get(), step, stream_);
    const auto new_count = static_cast<size_t>(result.count);
    // Children need their parents' centres, scales and rotations, so the new model is built beside the old
    // one.
    const bool is_larger = new_count > stride_;
    const size_t new_stride = is_larger ? PaddedStride(std::max(new_count, stride_ + stride_ / 2)) : stride_;
    spare_.Reserve(3 * kNumPlanes * new_stride);
    const Planes old_parameters = parameters();
    const Planes new_parameters = {spare_.get(), new_stride};
    densify_.Gather(old_parameters, new_parameters, stream_);
    densify_.PlaceChildren(old_parameters, new_parameters, step, stream_);
    Wait();
    model_.Swap(spare_);
    if (is_larger) spare_.Free();
    stride_ = new_stride;
    const int64_t old_count = count_;
    count_ = result.count;
    ReserveModelBuffers();
    ClearStatistics();
    if (count_ > old_count) {
      reports_.ExpectGrowth(static_cast<double>(count_) / static_cast<double>(old_count), &sorter_);
    }
    if (num_neighbours_ > 0) RefreshNeighbours(num_neighbours_);
    return result;
  }

  void ResetOpacity(float max_opacity) override {
    if (count_ == 0) return;
    const float max_logit = std::log(max_opacity / (1 - max_opacity));
    ClampOpacity(parameters(), first_moments(), second_moments(), count_, max_logit, stream_);
  }

  std::vector<float> PeakWeights(const std::vector<PinholeView>& views, SceneBodies bodies,
                                 DrawnBody drawn) override {
    if (count_ == 0) return {};
    ClearPeaks();
    for (const PinholeView& view : views) RaisePeaks(view, bodies, drawn, nullptr);
    return DownloadArray(peak_weights_.get(), static_cast<size_t>(count_), stream_);
  }

  BodySight SeeBody(const PinholeView& view, DrawnBody drawn, float min_weight) override {
    if (count_ == 0) return {};
    const auto n = static_cast<size_t>(count_);
    const size_t size = static_cast<size_t>(view.width) * view.height;
    is_seen_.Reserve(n);
    ClearPeaks();
    const Maps maps = maps_.Reserve(view.width, view.height, {});
    RaisePeaks(view, SceneBodies::kBoth, drawn, maps.transmittance);
    MarkSeen(peak_weights_.get(), count_, min_weight, is_seen_.get(), stream_);
    BodySight sight;
    sight.is_seen = DownloadArray(is_seen_.get(), n, stream_);
    sight.alpha = DownloadArray(maps.transmittance, size, stream_);
    return sight;
  }

  void RefreshNeighbours(int k) override {
    num_neighbours_ = static_cast<int>(std::min<int64_t>(std::min(k, kMaxNeighbours), count_ - 1));
    if (num_neighbours_ <= 0) {
      num_neighbours_ = 0;
      return;
    }
    neighbours_.Reserve(static_cast<size_t>(num_neighbours_) * static_cast<size_t>(count_));
    finder_.Find(parameters().At(kCentre), stride_, count_, num_neighbours_, neighbours_.get(), stream_);
  }

 private:
  struct Photo {
    PinholeView view;
    DevicePhoto device;
  };

  Planes parameters() const { return {model_.get(), stride_}; }
  Planes first_moments() const { return {model_.get() + kNumPlanes * stride_, stride_}; }
  Planes second_moments() const { return {model_.get() + 2 * kNumPlanes * stride_, stride_}; }

  // What `to` does from now on begins when `from` has done what it has.
  static void HandOver(cudaStream_t from, cudaEvent_t event, cudaStream_t to) {
    CheckCuda(cudaEventRecord(event, from), "streams");
    CheckCuda(cudaStreamWaitEvent(to, event), "streams");
  }

  // --- Colours ---
  ColorInput color_input() const {
    return {parameters(),      first_moments(), second_moments(), {scratch_.get(), stride_},
            is_skipped_.get(), count_,          num_processors_};
  }

  // Makes the updates that steps left to the next ones.
  void FinishColors() const {
    LearnColors(color_input(), color_log_.updates(), stream_);
    color_log_.WroteAll();
  }

  // --- Memory ---
  void ReserveModel(int64_t count) {
    const auto size = static_cast<size_t>(count);
    if (size > stride_ || model_.get() == nullptr) {
      spare_.Free();
      model_.Free();
      stride_ = PaddedStride(std::max(size, stride_ + stride_ / 2));
      model_.Reserve(std::max<size_t>(1, 3 * kNumPlanes * stride_));
    }
    ReserveModelBuffers();
    // The optimiser leaves zeros behind; what is new must begin with them.
    ClearStatistics();
  }

  // Arrays of one row per Gaussian besides the model.
  void ReserveModelBuffers() {
    if (d_splats_.capacity() < stride_ * kPackedFloats) {
      d_splats_.Reserve(stride_ * kPackedFloats);
      d_normal_z_.Reserve(stride_);
      CheckCuda(cudaMemsetAsync(d_splats_.get(), 0, sizeof(float) * stride_ * kPackedFloats, stream_),
                "gradients");
      CheckCuda(cudaMemsetAsync(d_normal_z_.get(), 0, sizeof(float) * stride_, stream_), "gradients");
    }
    d_logits_.Reserve(stride_);
    scratch_.Reserve(kNumScratchPlanes * stride_);
    color_traits_.Reserve(stride_);
    gradient_sum_.Reserve(stride_);
    view_count_.Reserve(stride_);
    sorter_.Reserve(static_cast<int64_t>(stride_), 1, 1);
  }

  void ClearStatistics() {
    const size_t bytes = sizeof(float) * static_cast<size_t>(count_);
    CheckCuda(cudaMemsetAsync(gradient_sum_.get(), 0, bytes, stream_), "statistics");
    CheckCuda(cudaMemsetAsync(view_count_.get(), 0, bytes, stream_), "statistics");
  }

  // --- What is seen ---
  void ClearPeaks() {
    peak_weights_.Reserve(static_cast<size_t>(count_));
    CheckCuda(cudaMemsetAsync(peak_weights_.get(), 0, sizeof(float) * static_cast<size_t>(count_), stream_),
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
    sorter_.Reserve(std::max<int64_t>(count_, 1), width, height);
    int64_t room = 0;
    if (count_ > 0) {
      Project(parameters(), count_, options, sorter_.splats(), stream_);
      DrawColors(color_input(), {}, options, sorter_.splats().splats, color_traits_.get(), stream_);
      sorter_.SortByDepth(count_, stream_);
      sorter_.ReportTotal(count_, reports_.report(), stream_);
      room = reports_.Count(stream_);
      sorter_.ReserveIntersections(room);
    }
    return {sorter_.splats(), sorter_.SortByTile(count_, width, height, room, reports_.report(), stream_),
            width, height, options.camera.near_depth};
  }

  // For as many pairs of a splat and a tile as there is room for.
  HitLists ReserveHits(int width, int height) {
    const size_t num_tiles = static_cast<size_t>(NumTiles(width)) * static_cast<size_t>(NumTiles(height));
    hits_.Reserve(kTileWarps * static_cast<size_t>(reports_.reserved_room()));
    hit_counts_.Reserve(kTileWarps * num_tiles);
    return {hits_.get(), hit_counts_.get()};
  }

  // --- Transfers ---
  std::vector<float> Chosen(const float* data, const std::vector<uint32_t>& indices) const {
    const std::vector<float> all = DownloadArray(data, static_cast<size_t>(count_), stream_);
    std::vector<float> chosen;
    chosen.reserve(indices.size());
    for (const uint32_t index : indices) chosen.push_back(all[index]);
    return chosen;
  }

  // In the stream's order: a plain cudaMemcpy goes to the default stream, returns when pageable memory is
  // staged and not when it has arrived, and this stream waits for no other. `values` must live until Wait().
  template <typename T>
  void Upload(const std::vector<T>& values, T* target, const char* what) const {
    CheckCuda(
        cudaMemcpyAsync(target, values.data(), values.size() * sizeof(T), cudaMemcpyHostToDevice, stream_),
        what);
  }

  void UploadSums(const std::vector<float>& values, float* target) const {
    if (values.empty()) return;
    S2GS_INVARIANT(values.size() == static_cast<size_t>(count_));
    Upload(values, target, "state");
    Wait();
  }

  Gaussians DownloadModel(const Planes& planes) const {
    Gaussians gaussians = DownloadGaussians(planes, static_cast<size_t>(count_), stream_);
    gaussians.sh_degree = sh_degree_;
    return gaussians;
  }

  std::string device_name_;
  int num_processors_ = 0;
  cudaStream_t stream_ = nullptr, side_stream_ = nullptr;
  cudaEvent_t step_begins_ = nullptr, colors_drawn_ = nullptr, maps_drawn_ = nullptr, maps_judged_ = nullptr,
              model_judged_ = nullptr;
  DeviceMemoryCount memory_;

  // The model: parameters, first and second moments, each kNumPlanes planes of stride_.
  DeviceBuffer<float> model_{&memory_};
  DeviceBuffer<float> spare_{&memory_};
  size_t stride_ = 0;
  int64_t count_ = 0;
  int sh_degree_ = 0;
  DeviceBuffer<float> gradient_sum_{&memory_}, view_count_{&memory_};
  DeviceBuffer<uint32_t> neighbours_{&memory_};
  int num_neighbours_ = 0;

  std::vector<Photo> photos_;
  DeviceBuffer<uint8_t> photo_bytes_{&memory_};

  TileSorter sorter_{&memory_};
  DensifyPlan densify_{&memory_};
  NeighbourFinder finder_{&memory_};
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
