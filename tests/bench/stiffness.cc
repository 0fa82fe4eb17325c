// Where a problem of this program is badly conditioned, what happens there, and what helps:
//   stiffness [--steps N]
//
// Prints the whole page, of which numerics.py makes results/stiffness.md; a program without SfM leaves the
// joint adjustment out. CPU seconds are of this process; iterations and errors do not depend on the machine.
// Adam and the surfaces are measured on the GPU, too, where there is one; the joint adjustment runs on the
// CPU whatever the backend.

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <functional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "mesh/fusion/tsdf.h"
#include "s2gs/core/gpu_info.h"
#include "s2gs/train_options.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/base/statistics.h"
#include "tests/bench/markdown_rows.h"
#include "tests/bench/stiffness_adam.h"
#include "tests/mesh/fusion/analytic_views.h"
#include "tests/support/random_numbers.h"
#ifdef S2GS_WITH_ADJUSTMENT
#include "tests/bench/stiffness_adjustment.h"
#endif

namespace s2gs {
namespace {

// --- Adam
// ---------------------------------------------------------------------------------------------------
struct AdamOutcome {
  double loss = 0;
  double worst = 0;  // of |size / truth - 1|
};

AdamOutcome OutcomeOf(const AdamProblem& problem, const std::function<double(int)>& parameter) {
  AdamOutcome outcome;
  for (int i = 0; i < AdamProblem::kCount; ++i) {
    const double x = parameter(i);
    const double off = (problem.logarithmic ? std::exp(x) : x) / problem.Truth(i) - 1;
    outcome.loss += off * off / AdamProblem::kCount;
    outcome.worst = std::isfinite(off) ? std::max(outcome.worst, std::abs(off)) : HUGE_VAL;
  }
  return outcome;
}

template <typename T>
AdamOutcome FitOnCpu(const AdamProblem& problem) {
  std::vector<AdamStep<T>> steps;
  for (int t = 1; t <= problem.iterations; ++t) steps.push_back(MakeAdamStep<T>(t));
  return OutcomeOf(problem, [&](int i) {
    const double truth = problem.Truth(i);
    return FitSize<T>(
        static_cast<T>(truth), static_cast<T>(problem.logarithmic ? std::log(3 * truth) : 3 * truth),
        problem.logarithmic, problem.adam, static_cast<T>(problem.rate), problem.iterations, steps.data());
  });
}

AdamOutcome FitOnGpu(const AdamProblem& problem) {
  const std::vector<float> x = FitSizesOnGpu(problem);
  return OutcomeOf(problem, [&](int i) { return x.at(static_cast<size_t>(i)); });
}

void AdamPart() {
  std::printf(
      "\n## Adam with scales that span 1e6\n\n"
      "%d sizes from 1 down to 1e-6 (and, for comparison, to .1), each started three times too large; the "
      "loss sees them relative to what they should be, as a picture does. Rates are the best of powers of "
      "ten from 1e-13 to 10 for each line after 1,000 iterations (for gradient descent those below 2 over "
      "the largest curvature); the last column is how far the worst size is off with .005, the rate of "
      "scales in training. `double` is the reference, `cpu` and `cuda` are the update of training "
      "(`s2gs/kernel/adam.h`) in float on either backend, on the GPU with training's own compiler flags.\n\n",
      AdamProblem::kCount);
  std::vector<std::pair<std::string, AdamOutcome (*)(const AdamProblem&)>> ways = {
      {"double", &FitOnCpu<double>}, {"cpu", &FitOnCpu<float>}};
  AdamProblem tried;
  tried.iterations = 1;
  if (!FitSizesOnGpu(tried).empty()) ways.emplace_back("cuda", &FitOnGpu);
  Head({"span", "parameter", "method", "condition", "measured on", "best rate", "loss", "worst size off by",
        "by training's rate"});
  for (const double span : {10.0, 1e6}) {
    for (const bool logarithmic : {false, true}) {
      for (const bool adam : {false, true}) {
        for (const auto& [name, fit] : ways) {
          AdamOutcome best;
          double best_rate = 0;
          for (double rate = 1e-13; rate < 20; rate *= 10) {
            const AdamOutcome outcome = fit({span, logarithmic, adam, rate, 1000});
            if (std::isfinite(outcome.loss) && (best_rate == 0 || outcome.loss < best.loss)) {
              best = outcome;
              best_rate = rate;
            }
          }
          const double worst = fit({span, logarithmic, adam, TrainOptions().scale_rate, 1000}).worst;
          Row({Number(span), logarithmic ? "log-scale" : "scale", adam ? "Adam" : "gradient descent",
               Number(logarithmic ? 1 : span * span, "%.0e"), name, Number(best_rate, "%.0e"),
               Number(best.loss), Number(best.worst),
               std::isfinite(worst) && worst < 1e9 ? Number(worst) : "diverges"});
        }
      }
    }
  }
  std::printf(
      "\nA log-scale makes all sizes alike (condition 1): gradient descent fails without it and is exact "
      "with it. Adam divides by each parameter's own gradient and reaches every size either way, on a loss "
      "without noise; but its first step has the rate's length, .005, whatever the size, so that a size of "
      "3e-6 passes through negative ones, which no splat has. Both together are what `s2gs/kernel` does: "
      "the step is a share of the size.\n");
}

// --- TSDF
// --------------------------------------------------------------------------------------------------- A box
// seen from a ring of cameras: its lid at the grazing angle 90 - elevation. Depths have noise along the ray,
// and the cameras are off sideways by a part of a pixel, which at grazing angles is depth.
void GrazingRow(TsdfBackend backend, double elevation, double max_angle) {
  AnalyticViewOptions options;
  options.ring_elevation_deg = elevation;
  std::vector<DepthView> views = AnalyticViews({BoxShape({0.5, 0.5, 0.5})}, options);
  RandomNumbers random(7);
  for (DepthView& view : views) {
    for (float& depth : view.depths) depth *= static_cast<float>(1 + 0.003 * random.Normal());
    const Eigen::Vector3d turn = 0.3 / options.focal * Eigen::Vector3d(random.Normal(), random.Normal(), 0);
    view.camera.cam_from_object =
        Rigid3{Eigen::Quaterniond(ExpRotation<double>(turn)), Eigen::Vector3d::Zero()} *
        view.camera.cam_from_object;
  }
  TsdfOptions tsdf;
  tsdf.backend = backend;
  tsdf.voxel_size = 0.02;
  tsdf.max_view_angle_deg = max_angle;
  TsdfSummary summary;
  Reporter silent;
  const double started = CpuSeconds();
  TriangleMesh mesh;
  try {
    mesh = MeshFromDepthMaps(DepthViewList(std::move(views)), tsdf, silent, &summary);
  } catch (const UserError&) {
    // Nothing is seen well enough: an empty mesh.
  }
  const double seconds = CpuSeconds() - started;
  std::vector<double> lid, sides;
  std::set<std::pair<int, int>> cells;
  for (const Eigen::Vector3f& vertex : mesh.vertices) {
    const Eigen::Vector3d x = vertex.cast<double>();
    // Away from the edges, where distances belong to one face.
    if (x.z() > 0.3 && x.head<2>().cwiseAbs().maxCoeff() < 0.44) {
      lid.push_back((x.z() - 0.5) / tsdf.voxel_size);
      cells.emplace(static_cast<int>(std::floor(x.x() / tsdf.voxel_size)),
                    static_cast<int>(std::floor(x.y() / tsdf.voxel_size)));
    } else if (std::abs(x.z()) < 0.4 && std::abs(x.y()) < 0.4) {
      sides.push_back((std::abs(x.x()) - 0.5) / tsdf.voxel_size);
    }
  }
  const auto rms = [](const std::vector<double>& values) {
    double sum = 0;
    for (const double value : values) sum += value * value;
    return values.empty() ? NAN : std::sqrt(sum / static_cast<double>(values.size()));
  };
  Row({backend == TsdfBackend::kCpu ? "cpu" : "cuda", Number(elevation), Number(90 - elevation),
       Number(1 / std::cos((90 - elevation) * kDegree)), Number(max_angle),
       Number(100 * static_cast<double>(cells.size()) / (44 * 44.0)), lid.empty() ? "-" : Number(rms(lid)),
       lid.empty() ? "-" : Number(Summarize(lid).mean), Number(rms(sides)), Number(seconds, "%.2f")});
  std::fflush(stdout);
}

void TsdfPart() {
  std::printf(
      "\n## TSDF at grazing angles\n\n"
      "A box of edges 1.0, seen by 40 cameras of one ring; its lid is seen at 90 degrees less the ring's "
      "height. "
      "Depths have noise of .3 %% of the distance in blocks of a pixel, cameras turned by .3 px. The "
      "amplification is "
      "1 / cos of the angle between ray and normal: how a pixel's error becomes one of depth. Lid: share of "
      "its area "
      "within one voxel of a vertex, RMS distance of those from it; sides for comparison.\n\n");
  std::vector<TsdfBackend> backends = {TsdfBackend::kCpu};
  const std::vector<GpuInfo> gpus = ListGpus();
  if (std::any_of(gpus.begin(), gpus.end(), [](const GpuInfo& gpu) { return gpu.is_usable; })) {
    backends.push_back(TsdfBackend::kCuda);
  }
  Head({"backend", "ring [deg]", "angle on the lid [deg]", "amplification", "max_view_angle_deg",
        "lid covered [%]", "lid RMS [voxels]", "lid bias [voxels]", "sides RMS [voxels]", "CPU [s]"});
  for (const TsdfBackend backend : backends) {
    for (const double elevation : {40.0, 15.0, 8.0, 4.0}) {
      for (const double max_angle : {60.0, 80.0, 89.0}) GrazingRow(backend, elevation, max_angle);
    }
  }
}

}  // namespace
}  // namespace s2gs

int main(int argc, char** argv) {
  [[maybe_unused]] int steps = 16;
  if (argc == 3 && std::string(argv[1]) == "--steps") steps = std::max(4, std::atoi(argv[2]));
  std::printf(
      "# Where problems are badly conditioned\n\n"
      "Generated by `python3 tests/bench/numerics.py BUILD/tests --backend cpu` and `--backend cuda`, which "
      "run "
      "`stiffness --steps %d`: what happens where a problem is badly conditioned, what helps, and what that "
      "costs. Iterations and errors are the same on every machine, CPU seconds are not. The adjustment runs "
      "on "
      "the CPU whatever the backend.\n\n",
      steps);
#ifdef S2GS_WITH_ADJUSTMENT
  s2gs::PrintAdjustmentStiffness(steps);
#endif
  s2gs::AdamPart();
  s2gs::TsdfPart();
  return EXIT_SUCCESS;
}
