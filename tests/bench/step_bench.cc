// Times training steps on the CPU: step_bench WORKSPACE GAUSSIANS.ply SIZE COUNT [STEPS]
//
// Photos are reduced to SIZE px, the model to its COUNT first Gaussians. Prints the time of a step with one
// and two threads, with and without the maps of geometry, and the arithmetic of the inner loops over pixels
// that it holds.

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <numeric>
#include <vector>

#include "s2gs/backend/backend.h"
#include "s2gs/cpu/gaussian_pass.h"
#include "s2gs/cpu/tile_lists.h"
#include "s2gs/gaussians_ply.h"
#include "s2gs/scene/scene_lengths.h"
#include "s2gs/scene/training_scene.h"
#include "s2gs/training/photos_at_level.h"
#include "tests/s2gs/usual_step.h"

namespace s2gs {
namespace {

// Operations of s2gs/cpu/tile_kernel_impl.h for eight pixels that may be hit, per pixel (an addition and a
// multiplication count one each, a division and a selection one): intersection and alpha, compositing, its
// adjoint.
constexpr double kForwardOperations = 58;
constexpr double kBackwardOperations = 112;

// Pixels that the inner loops visit in one view.
double VisitedPixels(const Gaussians& gaussians, const PinholeView& view) {
  const ViewSetup setup = MakeViewSetup(view, SceneBodies::kBoth, false, 3);
  std::vector<SplatRow> rows(gaussians.size());
  for (size_t i = 0; i < rows.size(); ++i) ProjectGaussian(gaussians, i, setup, &rows[i]);
  TileLists lists;
  ThreadPool threads(1);
  lists.Build(rows, view.width, view.height, &threads);
  double pixels = 0;
  for (int tile = 0; tile < lists.num_tiles(); ++tile) {
    const int x0 = tile % lists.tiles_x() * kTileSize;
    const int y0 = tile / lists.tiles_x() * kTileSize;
    for (const TileEntry& entry : lists.Entries(tile)) {
      const SplatRow& row = rows[entry.splat];
      const int height = std::min(row.y_end, y0 + kTileSize) - std::max(row.y_begin, y0);
      const int packs = (row.x_end > x0 + kPackWidth ? 2 : 1) - (row.x_begin >= x0 + kPackWidth ? 1 : 0);
      pixels += static_cast<double>(height) * packs * kPackWidth;
    }
  }
  return pixels;
}

double SecondsPerStep(const std::vector<TrainingPhoto>& photos, const TrainState& state, int threads,
                      bool geometry, int steps) {
  const auto backend = MakeCpuBackend(threads);
  backend->SetPhotos(photos);
  backend->SetState(state);
  TrainStep step = UsualStep();
  step.sh_degree = 3;
  step.weights.entropy_2d = 0.1F;
  step.weights.entropy_3d = 0.1F;
  if (geometry) step.weights.normal = 0.05F;
  std::vector<double> seconds;
  for (int i = 0; i < steps + 3; ++i) {
    step.iteration = i + 1;
    step.photo = i % static_cast<int>(photos.size());
    const auto begin = std::chrono::steady_clock::now();
    backend->Step(step);
    const std::chrono::duration<double> passed = std::chrono::steady_clock::now() - begin;
    if (i >= 3) seconds.push_back(passed.count());
  }
  std::nth_element(seconds.begin(), seconds.begin() + steps / 2, seconds.end());
  return seconds[steps / 2];
}

int Run(int argc, char** argv) {
  if (argc < 5) {
    std::fprintf(stderr, "usage: step_bench WORKSPACE GAUSSIANS.ply SIZE COUNT [STEPS]\n");
    return 2;
  }
  const std::filesystem::path workspace = argv[1];
  TrainingSceneOptions options;
  options.max_image_size = std::atoi(argv[3]);
  Reporter reporter;
  const TrainingScene scene = ReadTrainingScene({workspace / "sparse" / "0",
                                                 workspace / "sparse" / "static",
                                                 workspace / "turntable.json",
                                                 workspace / "images",
                                                 {},
                                                 {}},
                                                options, reporter);
  const Gaussians all = NormaliseGaussians(ReadGaussianPly(argv[2]), scene.origin, scene.size);
  std::vector<uint32_t> first(std::min<size_t>(std::atoi(argv[4]), all.size()));
  std::iota(first.begin(), first.end(), 0U);
  TrainState state;
  state.gaussians = SelectGaussians(all, first);
  const std::vector<TrainingPhoto> photos = PhotosAtLevel(scene, 0, 16);
  const int steps = argc > 5 ? std::atoi(argv[5]) : 60;

  double pixels = 0;
  for (const TrainingPhoto& photo : photos) {
    pixels += VisitedPixels(state.gaussians, photo.view) / static_cast<double>(photos.size());
  }
  const double operations = pixels * (kForwardOperations + kBackwardOperations);
  std::printf(
      "%d x %d px, %zu Gaussians, %.0f pixels visited by splats per view, %.3f G operations per step\n",
      photos[0].view.width, photos[0].view.height, state.gaussians.size(), pixels, operations * 1e-9);
  for (const bool geometry : {false, true}) {
    for (const int threads : {1, 2}) {
      const double seconds = SecondsPerStep(photos, state, threads, geometry, steps);
      std::printf("%d thread(s), %s normals: %.2f ms per step (median of %d)", threads,
                  geometry ? "with" : "without", 1e3 * seconds, steps);
      if (!geometry) std::printf(", %.1f G operations/s", operations / seconds * 1e-9);
      std::printf("\n");
    }
  }
  return 0;
}

}  // namespace
}  // namespace s2gs

int main(int argc, char** argv) {
  try {
    return s2gs::Run(argc, argv);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
}
