// Times training steps on the GPU: gpu_step_bench WORKSPACE GAUSSIANS.ply SIZE COUNT [STEPS] [REPEATS]
//
// Photos are brought to SIZE px. The model is brought to COUNT Gaussians of the same coverage (0: as it is):
// taken more than once, each moved within its disc and made smaller, or thinned out and made larger. Nothing
// is learnt, so that all steps are alike. Prints the time of a step while p is learnt, with all losses, and
// when it is frozen, with and without the maps of geometry; each is the median of REPEATS means over STEPS.

#include <Eigen/Geometry>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <vector>

#include "s2gs/backend/backend.h"
#include "s2gs/core/rng.h"
#include "s2gs/gaussians_ply.h"
#include "s2gs/image/photos.h"
#include "s2gs/scene/scene_lengths.h"
#include "s2gs/scene/training_scene.h"
#include "s2gs/training/photos_at_level.h"

namespace s2gs {
namespace {

constexpr size_t kMaxPhotos = 45;

Gaussians BringToCount(const Gaussians& all, size_t count) {
  std::vector<uint32_t> chosen;
  chosen.reserve(count);
  const double share = static_cast<double>(all.size()) / static_cast<double>(count);
  for (size_t i = 0; i < count; ++i) {
    chosen.push_back(static_cast<uint32_t>(std::min(share * static_cast<double>(i), all.size() - 1.0)));
  }
  Gaussians gaussians = SelectGaussians(all, chosen);
  const auto log_ratio = static_cast<float>(0.5 * std::log(share));
  for (size_t i = 0; i < count; ++i) {
    if (share < 1) {
      const Random4 bits = RandomBits(1, 2, i);
      const float* q = gaussians.rotation.data() + 4 * i;
      const Eigen::Quaternionf rotation(q[0], q[1], q[2], q[3]);
      const Eigen::Vector3f within = {
          (2 * UnitFloat(bits.words[0]) - 1) * std::exp(gaussians.log_scale[2 * i]),
          (2 * UnitFloat(bits.words[1]) - 1) * std::exp(gaussians.log_scale[2 * i + 1]), 0};
      const Eigen::Vector3f offset = rotation.normalized() * within;
      for (int axis = 0; axis < 3; ++axis) gaussians.centre[3 * i + axis] += offset[axis];
    }
    for (int axis = 0; axis < 2; ++axis) gaussians.log_scale[2 * i + axis] += log_ratio;
  }
  return gaussians;
}

std::vector<TrainingPhoto> PhotosOfSize(const TrainingScene& scene, int size) {
  std::vector<TrainingPhoto> photos = PhotosAtLevel(scene, 0, 16);
  photos.resize(std::min(photos.size(), kMaxPhotos));
  for (TrainingPhoto& photo : photos) {
    const double scale = static_cast<double>(size) / std::max(photo.view.width, photo.view.height);
    const int width = static_cast<int>(std::lround(scale * photo.view.width));
    const int height = static_cast<int>(std::lround(scale * photo.view.height));
    photo.image = ResizeByArea(photo.image, width, height);
    photo.view = ResizeView(photo.view, width, height);
    photo.mask.clear();
  }
  return photos;
}

double SecondsPerStep(Backend* backend, size_t num_photos, bool learns_foreground, bool geometry, int steps,
                      int repeats) {
  TrainStep step;
  step.sh_degree = kMaxShDegree;
  step.weights.dssim = 0.2F;
  step.freeze_foreground = !learns_foreground;
  if (geometry) step.weights.normal = 0.05F;
  if (learns_foreground) {
    step.weights.entropy_2d = 0.1F;
    step.weights.entropy_3d = 1;
    step.weights.local_consistency = 0.1F;
  }
  std::vector<double> seconds;
  for (int repeat = -1; repeat < repeats; ++repeat) {
    const auto begin = std::chrono::steady_clock::now();
    for (int i = 0; i < steps; ++i) {
      ++step.iteration;
      step.photo = static_cast<int>(step.iteration % static_cast<int64_t>(num_photos));
      backend->Step(step);
    }
    const LossTerms loss = backend->TakeLoss();
    const std::chrono::duration<double> passed = std::chrono::steady_clock::now() - begin;
    // The first pass finds out how many pairs of a splat and a tile there are.
    if (repeat < 0) continue;
    if (loss.steps != steps)
      std::printf("%d steps of %d were incomplete\n", steps - static_cast<int>(loss.steps), steps);
    seconds.push_back(passed.count() / steps);
  }
  std::nth_element(seconds.begin(), seconds.begin() + seconds.size() / 2, seconds.end());
  return seconds[seconds.size() / 2];
}

int Run(int argc, char** argv) {
  if (argc < 5) {
    std::fprintf(stderr, "usage: gpu_step_bench WORKSPACE GAUSSIANS.ply SIZE COUNT [STEPS] [REPEATS]\n");
    return 2;
  }
  const std::filesystem::path workspace = argv[1];
  const int steps = argc > 5 ? std::atoi(argv[5]) : 90, repeats = argc > 6 ? std::atoi(argv[6]) : 5;
  Reporter reporter;
  const TrainingScene scene = ReadTrainingScene({workspace / "sparse" / "0",
                                                 workspace / "sparse" / "static",
                                                 workspace / "turntable.json",
                                                 workspace / "images",
                                                 {},
                                                 {}},
                                                {}, reporter);
  TrainState state;
  state.gaussians = NormaliseGaussians(ReadGaussianPly(argv[2]), scene.origin, scene.size);
  const auto count = static_cast<size_t>(std::atoll(argv[4]));
  if (count > 0) state.gaussians = BringToCount(state.gaussians, count);
  const std::vector<TrainingPhoto> photos = PhotosOfSize(scene, std::atoi(argv[3]));
  const auto backend = MakeCudaBackend();
  backend->SetPhotos(photos);
  backend->SetState(state);
  backend->RefreshNeighbours(5);
  const auto time = [&](bool learns_foreground, bool geometry) {
    return 1e3 * SecondsPerStep(backend.get(), photos.size(), learns_foreground, geometry, steps, repeats);
  };
  const double learning = time(true, true), frozen = time(false, true), plain = time(false, false);
  const BackendInfo info = backend->Info();
  std::printf("| %zu | %d x %d | %.3f | %.3f | %.3f | %.0f |\n", state.gaussians.size(), photos[0].view.width,
              photos[0].view.height, learning, frozen, plain,
              static_cast<double>(info.peak_memory_bytes) / (1 << 20));
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
