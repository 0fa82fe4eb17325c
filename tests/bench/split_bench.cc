// Times the split by its steps.
//
//   split_bench DATABASE                   the photos of a database
//   split_bench --synthetic STATIONS STEPS [SEED]
//                                          a synthetic capture of STATIONS x STEPS images

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <map>
#include <string>
#include <vector>

#include "plugin/outputs/split_files.h"
#include "sfm_split/base/stopwatch.h"
#include "sfm_split/split/motion_split.h"
#include "tests/support/synthetic_turntable.h"

namespace s2gs {
namespace {

// Adds up the time between a task's first and last report.
class Stopwatch : public Reporter {
 public:
  void Progress(std::string_view task, int64_t done, int64_t total) override {
    const double now = SteadySeconds();
    if (task != task_) {
      task_ = std::string(task);
      begin_ = std::max(last_end_, begin_);
      if (done == 0) begin_ = now;
    }
    if (done == total && total > 0) {
      seconds_[task_] += now - begin_;
      task_.clear();
      last_end_ = now;
      begin_ = now;
    }
  }
  const std::map<std::string, double>& seconds() const { return seconds_; }

 private:
  std::string task_;
  double begin_ = SteadySeconds();
  double last_end_ = SteadySeconds();
  std::map<std::string, double> seconds_;
};

std::vector<SplitImage> Synthetic(int stations, int steps, uint64_t seed) {
  SyntheticTurntableOptions options;
  options.seed = seed;
  options.stations = stations;
  options.steps = steps;
  options.step_deg = 360.0 / steps;
  options.pixel_noise = 0.5;
  options.dropout = 0.2;
  options.num_extra_keypoints = 300;
  options.descriptors = true;
  options.pairs = {{0, 1}};
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  std::vector<SplitImage> images;
  images.reserve(turntable.images.size());
  for (size_t i = 0; i < turntable.images.size(); ++i) {
    SplitImage& image = images.emplace_back();
    image.name = turntable.scene.views[i].name;
    image.size = {options.width, options.height};
    for (const SyntheticKeypoint& keypoint : turntable.images[i].keypoints)
      image.keypoints.emplace_back(keypoint.xy.cast<float>());
    for (const SiftDescriptor& descriptor : turntable.images[i].descriptors)
      image.descriptors.insert(image.descriptors.end(), descriptor.begin(), descriptor.end());
  }
  return images;
}

int Run(const std::vector<SplitImage>& images) {
  size_t num_keypoints = 0;
  for (const SplitImage& image : images) num_keypoints += image.keypoints.size();
  Stopwatch stopwatch;
  const double begin = SteadySeconds();
  const MotionSplit split = SplitMotion(images, {}, &stopwatch);
  const double seconds = SteadySeconds() - begin;
  std::printf("%zu images, %zu keypoints each, %s: %.2f s, %lld pairs matched, %zu object pairs\n",
              images.size(), num_keypoints / images.size(), CaptureCaseName(split.capture_case), seconds,
              static_cast<long long>(split.num_pairs_matched), split.object_pairs.size());
  double rest = seconds;
  for (const auto& [task, of_task] : stopwatch.seconds()) {
    std::printf("  %-22s %7.2f s\n", task.c_str(), of_task);
    rest -= of_task;
  }
  std::printf("  %-22s %7.2f s\n", "everything else", rest);
  return 0;
}

}  // namespace
}  // namespace s2gs

int main(int argc, char** argv) {
  try {
    if (argc == 2) return s2gs::Run(s2gs::ReadSplitFeatures(argv[1]).images);
    if ((argc == 4 || argc == 5) && std::strcmp(argv[1], "--synthetic") == 0) {
      return s2gs::Run(
          s2gs::Synthetic(std::atoi(argv[2]), std::atoi(argv[3]), argc == 5 ? std::atoi(argv[4]) : 1));
    }
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
  std::fprintf(stderr, "usage: split_bench DATABASE | --synthetic STATIONS STEPS [SEED]\n");
  return 1;
}
