// Training, drawing and meshing at the ends of what numbers allow, at full size:
//   numerics_stress [--use_gpu 0|1] [--gaussians N] [--max_side PX] [--pairs_side PX] [--iterations N]
//
// Prints a table of case, result and verdict; the exit code is 1 when any case fails. Without options the
// sizes are small enough for every run of the tests; at full size: --use_gpu 1 --gaussians 10000000
// --max_side 8192.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <functional>
#include <limits>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "mesh/fusion/tsdf.h"
#include "s2gs/backend/backend.h"
#include "s2gs/initialise.h"
#include "s2gs/kernel/foreground.h"
#include "s2gs/scene/scene_lengths.h"
#include "s2gs/scene/training_scene.h"
#include "s2gs/training/train.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/base/stopwatch.h"
#include "tests/mesh/fusion/analytic_views.h"
#include "tests/s2gs/usual_step.h"
#include "tests/support/random_numbers.h"

namespace s2gs {
namespace {

struct Sizes {
  bool use_gpu = false;
  int64_t gaussians = 20'000;
  int max_side = 700;     // [px]
  int pairs_side = 2048;  // of the image that 2^31 pairs of splat and tile reach [px]
  int64_t iterations = 60;
};

struct Result {
  std::string text;
  bool holds = false;
};

std::string Format(const char* format, double value) {
  char text[64];
  std::snprintf(text, sizeof text, format, value);
  return text;
}

std::unique_ptr<Backend> NewBackend(const Sizes& sizes) {
  return sizes.use_gpu ? MakeCudaBackend(0) : MakeCpuBackend(0);
}

// --- Scenes whose photos are drawn from a known model
// -----------------------------------------------------------
struct SceneOptions {
  int64_t gaussians = 400;
  int photos = 8;
  int width = 64;
  int height = 48;
  double focal_widths = 1.2;
  bool turns = true;
};

Gaussians RandomModel(int64_t count, double log_scale_spread) {
  RandomNumbers random(5);
  Gaussians model;
  model.Resize(static_cast<size_t>(count));
  model.sh_degree = 1;
  // So that they cover a sphere of radius 1 about twice, whatever their number.
  const double mean = std::log(1.2 / std::cbrt(static_cast<double>(count)));
  for (size_t i = 0; i < model.size(); ++i) {
    const bool rotates = i % 2 == 0;
    const Eigen::Vector3d x = (rotates ? 0.5 : 1.0) * std::cbrt(random.Uniform()) * random.Direction();
    for (int k = 0; k < 3; ++k) model.centre[3 * i + static_cast<size_t>(k)] = static_cast<float>(x[k]);
    for (size_t k = 0; k < 2; ++k) {
      model.log_scale[2 * i + k] =
          static_cast<float>(mean + random.Uniform(-0.5 - log_scale_spread / 2, 0.5 + log_scale_spread / 2));
    }
    for (size_t k = 0; k < 4; ++k) model.rotation[4 * i + k] = static_cast<float>(random.Normal());
    model.opacity_logit[i] = static_cast<float>(random.Uniform(-1, 4));
    model.foreground_logit[i] = rotates ? 6.0F : -6.0F;
    for (size_t k = 0; k < 3; ++k) model.sh_dc[3 * i + k] = static_cast<float>(random.Uniform(-1.5, 1.5));
  }
  return model;
}

// On a ring; a long lens stands farther away, a wide one nearer, so that the model fills the photos.
PinholeView RingView(const SceneOptions& options, int photo) {
  PinholeView view;
  view.width = options.width;
  view.height = options.height;
  view.fx = view.fy = options.focal_widths * options.width;
  view.cx = 0.5 * options.width;
  view.cy = 0.5 * options.height;
  const double turn = 2 * kPi * photo / options.photos;
  // Looking along +y from -distance, y down.
  Eigen::Matrix3d look;
  look << 1, 0, 0, 0, 0, -1, 0, 1, 0;
  const double distance = std::max(1.3, 3 * options.focal_widths);
  view.cam_from_world = {Eigen::Quaterniond(look), {0, 0, distance}};
  const Eigen::Matrix3d rotation = RotationAbout<double>(Eigen::Vector3d::UnitZ(), turn);
  const Rigid3 table = {Eigen::Quaterniond(rotation), Eigen::Vector3d::Zero()};
  view.cam_from_object = view.cam_from_world * table;
  if (!options.turns) view.cam_from_world = view.cam_from_object;
  return view;
}

TrainingScene DrawnScene(const SceneOptions& options, Backend* backend) {
  TrainingScene scene;
  scene.mode = options.turns ? TrainMode::kS2gs : TrainMode::kStatic;
  TrainState state;
  state.gaussians = RandomModel(options.gaussians, 0);
  backend->SetState(state);
  for (int i = 0; i < options.photos; ++i) {
    ScenePhoto photo;
    photo.name = std::to_string(1000 + i) + ".png";
    photo.view = RingView(options, i);
    photo.held_out = options.photos > 4 && i % 4 == 1;
    RenderRequest request;
    request.view = photo.view;
    request.freeze_foreground = true;
    request.bodies = scene.bodies();
    const RenderedView drawn = backend->Render(request);
    photo.image = {options.width, options.height, 3, {}};
    for (const float value : drawn.color) {
      photo.image.pixels.push_back(static_cast<uint8_t>(std::clamp(255 * value + 0.5F, 0.0F, 255.0F)));
    }
    scene.photos.push_back(std::move(photo));
  }
  for (size_t i = 0; i < state.gaussians.size(); i += 2 * (state.gaussians.size() / 400) + 1) {
    const float* x = state.gaussians.centre.data() + 3 * i;
    scene.points.push_back({{x[0], x[1], x[2]}, {128, 128, 128}, options.turns && i % 2 == 0});
  }
  scene.axis = TurntableAxis{Eigen::Vector3d::Zero(), Eigen::Vector3d::UnitZ()};
  if (!options.turns) scene.axis.reset();
  return scene;
}

TrainOptions QuickOptions(int64_t iterations) {
  TrainOptions options;
  options.num_iterations = iterations;
  options.initial.min_points = 300;
  options.growth = GrowthStrategy::kBudget;
  options.max_gaussians = 2000;
  options.densify_every = 20;
  options.min_coarse_size = 32;
  options.num_measurements = 2;
  options.normal_from = 0.2;
  options.distortion_weight = 10;
  return options;
}

int64_t CountNotFinite(const std::vector<float>& values) {
  return std::count_if(values.begin(), values.end(), [](float v) { return !std::isfinite(v); });
}
int64_t CountNotFinite(const Gaussians& g) {
  int64_t count = 0;
  for (const auto* values :
       {&g.centre, &g.log_scale, &g.rotation, &g.opacity_logit, &g.sh_dc, &g.sh_rest, &g.foreground_logit}) {
    count += CountNotFinite(*values);
  }
  return count;
}
int64_t CountNotFinite(const RenderedView& view) {
  int64_t count = 0;
  for (const auto* values : {&view.color, &view.alpha, &view.expected_depth, &view.median_depth, &view.normal,
                             &view.distortion, &view.foreground}) {
    count += CountNotFinite(*values);
  }
  return count;
}

// Trains, and holds when every number of the model is finite.
Result TrainsFinite(TrainingScene scene, const Sizes& sizes, TrainResult* trained = nullptr,
                    TrainOptions options = QuickOptions(0)) {
  NormaliseScene(&scene);
  options.num_iterations = sizes.iterations;
  Reporter silent;
  const TrainResult result = Train(scene, options, 1, {}, NewBackend(sizes).get(), silent);
  const int64_t not_finite = CountNotFinite(result.gaussians);
  if (trained != nullptr) *trained = result;
  std::string text = std::to_string(result.gaussians.size()) + " Gaussians, " + std::to_string(not_finite) +
                     " numbers not finite";
  if (result.held_out) text += Format(", held-out %.2f dB", result.held_out->psnr);
  return {text, not_finite == 0};
}

// --- Cases -------------------------------------------------------------------------------------------------
Result ManyGaussians(const Sizes& sizes) {
  SceneOptions options;
  options.gaussians = sizes.gaussians;
  options.photos = 1;
  options.width = std::min(sizes.max_side, 1920);
  options.height = options.width * 9 / 16;
  const auto backend = NewBackend(sizes);
  const TrainingScene scene = DrawnScene(options, backend.get());
  backend->SetPhotos({{scene.photos[0].view, scene.photos[0].image, {}}});
  TrainStep step = UsualStep();
  step.sh_degree = 3;
  step.weights.normal = step.weights.entropy_2d = step.weights.entropy_3d = 0.1F;
  step.weights.distortion = 1;
  step.rates.centre = 1e-4F;
  step.collect_statistics = true;
  for (step.iteration = 1; step.iteration <= 3; ++step.iteration) backend->Step(step);
  const LossTerms loss = backend->TakeLoss();
  RenderRequest request;
  request.view = scene.photos[0].view;
  request.geometry = request.foreground = true;
  const int64_t not_finite = CountNotFinite(backend->Render(request));
  DensifyStep densify;
  densify.iteration = 3;
  densify.max_clone_scale = 1;
  densify.max_count = sizes.gaussians + sizes.gaussians / 100;
  const DensifyResult grown = backend->Densify(densify);
  const double gib = static_cast<double>(backend->Info().peak_memory_bytes) / (1U << 30U);
  return {std::to_string(sizes.gaussians) + " Gaussians, " + std::to_string(options.width) + " px wide: " +
              std::to_string(not_finite) + " numbers not finite, " + std::to_string(grown.count) +
              " after growth" + Format(", loss %.4f", loss.total) + Format(", peak %.2f GiB", gib),
          not_finite == 0 && std::isfinite(loss.total) && grown.not_finite == 0};
}

// Refused before anything of that size is allocated, or drawn.
Result ManyPairs(const Sizes& sizes) {
  constexpr int kTile = 16;
  const int64_t tiles = static_cast<int64_t>(sizes.pairs_side / kTile) * (sizes.pairs_side / kTile);
  Gaussians layers;
  layers.Resize(static_cast<size_t>((int64_t{1} << 31U) / tiles + 1));
  std::fill(layers.log_scale.begin(), layers.log_scale.end(), 8.0F);
  std::fill(layers.foreground_logit.begin(), layers.foreground_logit.end(), -20.0F);
  for (size_t i = 0; i < layers.size(); ++i) layers.rotation[4 * i] = 1;
  SceneOptions options;
  options.width = options.height = sizes.pairs_side;
  RenderRequest request;
  request.view = RingView(options, 0);
  request.view.cam_from_world.rotation.setIdentity();
  request.view.cam_from_object = request.view.cam_from_world;
  const auto backend = NewBackend(sizes);
  TrainState state;
  state.gaussians = std::move(layers);
  backend->SetState(state);
  try {
    const int64_t not_finite = CountNotFinite(backend->Render(request));
    return {"drawn, " + std::to_string(not_finite) + " numbers not finite", not_finite == 0};
  } catch (const UserError& error) {
    return {std::string("refused: ") + error.what(), true};
  }
}

// The same scene in other units and places.
void ScaledAndMoved(const Sizes& sizes,
                    const std::function<void(const std::string&, const Result&)>& report) {
  double reference = 0;
  const auto base = DrawnScene({}, NewBackend(sizes).get());
  for (const double move : {0.0, 1e6}) {
    for (const double scale : {1.0, 1e-3, 1e3}) {
      TrainingScene scene = base;
      const Eigen::Vector3d shift = scale * move * Eigen::Vector3d(0.6, -0.7, 0.4);
      for (ScenePhoto& photo : scene.photos) {
        for (Rigid3* pose : {&photo.view.cam_from_world, &photo.view.cam_from_object}) {
          pose->translation = scale * pose->translation - pose->rotation * shift;
        }
      }
      for (ScenePoint& point : scene.points) point.x = scale * point.x + shift;
      scene.axis->point = scale * scene.axis->point + shift;
      TrainResult trained;
      Result result = TrainsFinite(scene, sizes, &trained);
      if (move == 0 && scale == 1) reference = trained.held_out->psnr;
      const double change = trained.held_out->psnr - reference;
      // Other rounding grows over the iterations: half a decibel is what seeds differ by.
      result.holds = result.holds && std::abs(change) < 0.5;
      result.text += Format(", %+.3f dB", change);
      report("scene x " + Format("%g", scale) + (move > 0 ? ", moved by 1e6 sizes" : ""), result);
    }
  }
}

Result FocalLength(const Sizes& sizes, double focal_widths) {
  SceneOptions options;
  options.focal_widths = focal_widths;
  TrainResult trained;
  Result result = TrainsFinite(DrawnScene(options, NewBackend(sizes).get()), sizes, &trained);
  result.holds = result.holds && trained.held_out && std::isfinite(trained.held_out->psnr);
  return result;
}

Result PhotoSize(const Sizes& sizes, int width, int height) {
  SceneOptions options;
  options.width = width;
  options.height = height;
  options.photos = 2;
  options.focal_widths = std::max(1.2, 0.6 * height / width);
  Sizes fewer = sizes;
  if (int64_t{width} * height > 4'000'000) fewer.iterations = std::min<int64_t>(sizes.iterations, 30);
  return TrainsFinite(DrawnScene(options, NewBackend(sizes).get()), fewer);
}

Result Photos(const Sizes& sizes, int count, const std::function<void(int, ScenePhoto*)>& change) {
  TrainingScene scene = DrawnScene({}, NewBackend(sizes).get());
  scene.photos.resize(static_cast<size_t>(count));
  for (int i = 0; i < count; ++i) {
    scene.photos[static_cast<size_t>(i)].held_out = false;
    change(i, &scene.photos[static_cast<size_t>(i)]);
  }
  return TrainsFinite(std::move(scene), sizes);
}

// p of all Gaussians saturated at the start, with every term of the loss that works on it.
Result ForegroundAllAlike(const Sizes& sizes, float logit) {
  const auto backend = NewBackend(sizes);
  const TrainingScene scene = DrawnScene({}, backend.get());
  TrainState state;
  state.gaussians = RandomModel(400, 0);
  std::fill(state.gaussians.foreground_logit.begin(), state.gaussians.foreground_logit.end(), logit);
  backend->SetState(state);
  backend->SetPhotos(
      {{scene.photos[0].view, scene.photos[0].image, {}}, {scene.photos[3].view, scene.photos[3].image, {}}});
  backend->RefreshNeighbours(5);
  TrainStep step = UsualStep();
  step.sh_degree = 1;
  step.weights.local_consistency = step.weights.entropy_3d = step.weights.entropy_2d = 1;
  step.rates.centre = 1e-4F;
  for (step.iteration = 1; step.iteration <= sizes.iterations; ++step.iteration) {
    step.photo = static_cast<int>(step.iteration % 2);
    backend->Step(step);
  }
  const LossTerms loss = backend->TakeLoss();
  const int64_t not_finite = CountNotFinite(backend->GetGaussians());
  return {std::to_string(not_finite) + " numbers not finite" + Format(", loss %.4f", loss.total),
          not_finite == 0 && std::isfinite(loss.total)};
}

Result ScalesSpanning(const Sizes& sizes, double factor) {
  const auto backend = NewBackend(sizes);
  const TrainingScene scene = DrawnScene({}, backend.get());
  TrainState state;
  state.gaussians = RandomModel(400, std::log(factor));
  backend->SetState(state);
  backend->SetPhotos({{scene.photos[0].view, scene.photos[0].image, {}}});
  TrainStep step = UsualStep();
  step.sh_degree = 1;
  step.weights.normal = 0.05F;
  step.weights.distortion = 10;
  step.rates.centre = 1e-4F;
  double first = 0;
  for (step.iteration = 1; step.iteration <= sizes.iterations; ++step.iteration) {
    backend->Step(step);
    if (step.iteration == 1) first = backend->TakeLoss().total;
  }
  backend->TakeLoss();
  backend->Step(step);
  const double last = backend->TakeLoss().total;
  const int64_t not_finite = CountNotFinite(backend->GetGaussians());
  return {std::to_string(not_finite) + " numbers not finite" + Format(", loss %.4f", first) +
              Format(" to %.4f", last),
          not_finite == 0 && last < first};
}

Result HalfNan(const Sizes& sizes) {
  const auto backend = NewBackend(sizes);
  const TrainingScene scene = DrawnScene({}, backend.get());
  TrainState state;
  state.gaussians = RandomModel(std::max<int64_t>(sizes.gaussians / 10, 400), 0);
  RandomNumbers random(9);
  Gaussians& g = state.gaussians;
  std::vector<float>* const arrays[] = {&g.centre, &g.log_scale, &g.rotation,        &g.opacity_logit,
                                        &g.sh_dc,  &g.sh_rest,   &g.foreground_logit};
  const auto count = static_cast<int64_t>(g.size());
  for (size_t i = 0; i < g.size(); i += 2) {
    std::vector<float>& values = *arrays[random.Index(std::size(arrays))];
    const size_t width = values.size() / g.size();
    values[i * width + random.Index(width)] = std::numeric_limits<float>::quiet_NaN();
  }
  backend->SetState(state);
  backend->SetPhotos({{scene.photos[0].view, scene.photos[0].image, {}}});
  backend->RefreshNeighbours(5);
  TrainStep step = UsualStep();
  step.sh_degree = 3;
  step.weights.local_consistency = step.weights.entropy_3d = step.weights.entropy_2d = 1;
  step.rates.centre = 1e-4F;
  for (step.iteration = 1; step.iteration <= 10; ++step.iteration) backend->Step(step);
  RenderRequest request;
  request.view = scene.photos[0].view;
  request.geometry = request.foreground = true;
  const int64_t in_maps = CountNotFinite(backend->Render(request));
  DensifyStep densify;
  densify.grow = false;
  densify.min_opacity = 0;
  const DensifyResult result = backend->Densify(densify);
  const int64_t left = CountNotFinite(backend->GetGaussians());
  return {std::to_string(in_maps) + " numbers not finite in the maps; " + std::to_string(result.not_finite) +
              " of " + std::to_string(count) + " removed, " + std::to_string(left) +
              " numbers not finite left",
          in_maps == 0 && left == 0 && result.not_finite == (count + 1) / 2};
}

Result HalfOfTheDepthsNan(const Sizes& sizes) {
  AnalyticViewOptions options;
  options.width = options.height = std::clamp(sizes.max_side / 4, 100, 600);
  options.focal = 2.0 * options.width;
  options.principal_point = {0.5 * options.width, 0.5 * options.height};
  std::vector<DepthView> views = AnalyticViews({SphereShape(0.8)}, options);
  RandomNumbers random(3);
  for (DepthView& view : views) {
    for (float& depth : view.depths) {
      if (random.Uniform() < 0.5) depth = std::numeric_limits<float>::quiet_NaN();
    }
  }
  TsdfOptions tsdf;
  tsdf.backend = sizes.use_gpu ? TsdfBackend::kCuda : TsdfBackend::kCpu;
  TsdfSummary summary;
  Reporter silent;
  const TriangleMesh mesh = MeshFromDepthMaps(DepthViewList(std::move(views)), tsdf, silent, &summary);
  double squares = 0;
  bool finite = true;
  for (const Eigen::Vector3f& vertex : mesh.vertices) {
    finite = finite && vertex.allFinite();
    squares += std::pow((vertex.cast<double>().norm() - 0.8) / summary.voxel_size, 2);
  }
  const double rms = std::sqrt(squares / static_cast<double>(std::max<size_t>(1, mesh.vertices.size())));
  return {
      std::to_string(mesh.vertices.size()) + " vertices" + Format(", RMS %.3f voxels from the sphere", rms),
      finite && mesh.vertices.size() > 1000 && rms < 0.2};
}

// --- All of them
// ---------------------------------------------------------------------------------------------
int Run(const Sizes& sizes) {
  int failed = 0;
  const auto report = [&failed](const std::string& name, const Result& result) {
    failed += result.holds ? 0 : 1;
    std::printf("| %s | %s | %s |\n", name.c_str(), result.text.c_str(),
                result.holds ? "holds" : "**fails**");
    std::fflush(stdout);
  };
  const auto run = [&](const std::string& name, const std::function<Result()>& test) {
    try {
      report(name, test());
    } catch (const std::exception& error) {
      report(name, {error.what(), false});
    }
  };
  std::printf("Backend: %s.\n\n| case | result | |\n|---|---|---|\n",
              NewBackend(sizes)->Info().device.c_str());
  run("many Gaussians", [&] { return ManyGaussians(sizes); });
  run("2^31 pairs of splat and tile", [&] { return ManyPairs(sizes); });
  try {
    ScaledAndMoved(sizes, report);
  } catch (const std::exception& error) {
    report("scale and place", {error.what(), false});
  }
  for (const double focal : {0.3, 1.0, 3.0, 10.0}) {
    run("focal length " + Format("%g", focal) + " x width", [&] { return FocalLength(sizes, focal); });
  }
  const int side = sizes.max_side;
  for (const auto& [width, height] : {std::pair(1, 1), std::pair(2, 3), std::pair(17, 1), std::pair(1, side),
                                      std::pair(side, 1), std::pair(side, side)}) {
    run("photos of " + std::to_string(width) + " x " + std::to_string(height),
        [&, w = width, h = height] { return PhotoSize(sizes, w, h); });
  }
  const auto fill = [](uint8_t value) {
    return [value](int, ScenePhoto* photo) {
      std::fill(photo->image.pixels.begin(), photo->image.pixels.end(), value);
    };
  };
  const auto as_is = [](int, ScenePhoto*) {};
  run("one photo", [&] { return Photos(sizes, 1, as_is); });
  run("two photos", [&] { return Photos(sizes, 2, as_is); });
  run("six identical photos", [&] {
    const TrainingScene scene = DrawnScene({}, NewBackend(sizes).get());
    return Photos(sizes, 6, [&](int i, ScenePhoto* photo) {
      *photo = scene.photos[0];
      photo->name = std::to_string(i) + ".png";
    });
  });
  run("black photos", [&] { return Photos(sizes, 6, fill(0)); });
  run("white photos", [&] { return Photos(sizes, 6, fill(255)); });
  run("overexposed photos", [&] {
    return Photos(sizes, 6, [](int, ScenePhoto* photo) {
      for (uint8_t& value : photo->image.pixels) value = static_cast<uint8_t>(std::min(255, 4 * value));
    });
  });
  for (const float logit : {-1e4F, -30.0F, 30.0F, 1e4F}) {
    run("p of all at logit " + Format("%g", static_cast<double>(logit)),
        [&] { return ForegroundAllAlike(sizes, logit); });
  }
  run("scales spanning 1e6", [&] { return ScalesSpanning(sizes, 1e6); });
  run("half of all Gaussians NaN", [&] { return HalfNan(sizes); });
  run("half of all depths NaN", [&] { return HalfOfTheDepthsNan(sizes); });
  std::printf("\n%d failed.\n", failed);
  return failed == 0 ? EXIT_SUCCESS : EXIT_FAILURE;
}

}  // namespace
}  // namespace s2gs

int main(int argc, char** argv) {
  s2gs::Sizes sizes;
  for (int i = 1; i + 1 < argc; i += 2) {
    const std::string name = argv[i];
    const int64_t value = std::atoll(argv[i + 1]);
    if (name == "--use_gpu") {
      sizes.use_gpu = value != 0;
    } else if (name == "--gaussians") {
      sizes.gaussians = value;
    } else if (name == "--max_side") {
      sizes.max_side = static_cast<int>(value);
    } else if (name == "--pairs_side") {
      sizes.pairs_side = static_cast<int>(value);
    } else if (name == "--iterations") {
      sizes.iterations = value;
    } else {
      std::fprintf(stderr, "unknown option %s\n", argv[i]);
      return EXIT_FAILURE;
    }
  }
  try {
    return s2gs::Run(sizes);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return EXIT_FAILURE;
  }
}
