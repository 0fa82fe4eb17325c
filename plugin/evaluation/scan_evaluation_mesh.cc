#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <filesystem>
#include <limits>
#include <string>
#include <system_error>
#include <vector>

#include "mesh/surface/mesh_error.h"
#include "plugin/evaluation/scan_evaluation.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;
using Eigen::Vector3d;

constexpr uint64_t kEstimateStream = 0;
// The disc's top itself and what stands up from it by this share of the diameter are not the object's
// surface.
constexpr double kAboveDiscRatio = 0.01;
// Samples farther than this share of the diameter from the object's bounding box count as outside.
constexpr double kBoxMarginRatio = 0.1;

Eigen::AlignedBox3d ObjectBox(const ScanTruth& truth) {
  Eigen::AlignedBox3d box;
  for (const Eigen::Vector3f& vertex : truth.object.vertices) box.extend(vertex.cast<double>());
  const Vector3d margin = Vector3d::Constant(kBoxMarginRatio * truth.diameter);
  return {box.min() - margin, box.max() + margin};
}

CropRegion MakeRegion(const ScanTruth& truth, const MeshEvaluationOptions& options) {
  CropRegion region;
  if (truth.disc.has_value()) {
    const Vector3d up = truth.scene.axis.direction;
    double top = -std::numeric_limits<double>::infinity();
    for (const Eigen::Vector3f& vertex : truth.disc->vertices)
      top = std::max(top, up.dot(vertex.cast<double>()));
    region.plane = Eigen::Hyperplane<double, 3>(up, -(top + kAboveDiscRatio * truth.diameter));
  }
  if (!options.crop_min.empty()) {
    region.box = Eigen::AlignedBox3d(Eigen::Map<const Vector3d>(options.crop_min.data()),
                                     Eigen::Map<const Vector3d>(options.crop_max.data()));
  }
  return region;
}

std::vector<ObjectView> TrainViews(const SceneTruth& truth) {
  std::vector<ObjectView> views;
  // What is seen hardly depends on distortion.
  const Eigen::Vector2d focal = FocalLengths(truth.camera);
  const Eigen::Vector2d centre = PrincipalPoint(truth.camera);
  for (const SceneTruthImage& image : truth.images) {
    if (!image.is_train) continue;
    views.push_back({static_cast<int>(truth.camera.width), static_cast<int>(truth.camera.height), focal.x(),
                     focal.y(), centre.x(), centre.y(), image.CamFromObject()});
  }
  return views;
}

// The distances between the mesh and the true surface, measured in one way.
struct SurfaceFigures {
  Figure chamfer, accuracy, completeness;
  std::vector<Figure> f_scores;

  // \param infix  tells the figures' names from those of the other way; `how` ends their definitions.
  SurfaceFigures(const std::string& infix, const std::string& how,
                 const std::vector<double>& thresholds_pct) {
    chamfer = Percent("chamfer" + infix,
                      "Chamfer-L1, (accuracy + completeness) / 2, in % of the object's diameter" + how);
    accuracy = Percent("accuracy" + infix,
                       "mean distance of the mesh to the true surface, in % of the diameter" + how);
    completeness = Percent("completeness" + infix,
                           "mean distance of the seen true surface to the mesh, in % of the diameter" + how);
    for (const double threshold : thresholds_pct) {
      f_scores.push_back(
          {fmt::format("f1{}_{}pct", infix, threshold),
           "",
           fmt::format("F-score, precision and recall at {} % of the object's diameter{}", threshold, how),
           {},
           ""});
    }
  }

  void Fill(const SurfaceErrors& errors, double diameter) {
    const double percent = 100 / diameter;
    chamfer.values = {{"value", percent * errors.chamfer_l1}};
    accuracy.values = {{"value", percent * errors.accuracy}};
    completeness.values = {{"value", percent * errors.completeness}};
    for (size_t i = 0; i < f_scores.size(); ++i) {
      const FScore& score = errors.f_scores[i];
      f_scores[i].values = {
          {"value", score.f_score}, {"precision", score.precision}, {"recall", score.recall}};
    }
  }

  void List(std::vector<Figure*>* all) {
    for (Figure* figure : {&chamfer, &accuracy, &completeness}) all->push_back(figure);
    for (Figure& figure : f_scores) all->push_back(&figure);
  }

 private:
  static Figure Percent(const std::string& name, const std::string& definition) {
    return {name + "_pct", "%", definition, {}, ""};
  }
};

struct MeshFigures {
  explicit MeshFigures(const std::vector<double>& thresholds_pct)
      : exact("", "; over samples of one surface, to the triangles of the other", thresholds_pct),
        sampled("_sampled", "; over samples of one surface, to samples of the other", thresholds_pct) {}

  Figure faces{"faces", "triangles", "triangles of the mesh", {}, ""};
  Figure unusable{"unusable_faces", "triangles", "triangles without area, which are never sampled", {}, ""};
  Figure outside{
      "outside_box_pct",
      "%",
      "share of the mesh's samples above the disc yet outside the object's bounding box, widened by 10 % "
      "of the diameter",
      {},
      ""};
  Figure seen{"gt_seen_pct",
              "%",
              "share of the true surface above the disc that two train views or more see",
              {},
              ""};
  SurfaceFigures exact, sampled;

  void Finish(const std::string& missing, Figures* figures) {
    std::vector<Figure*> all = {&faces, &unusable, &outside, &seen};
    exact.List(&all);
    sampled.List(&all);
    for (Figure* figure : all) {
      figure->missing = missing;
      figures->push_back(std::move(*figure));
    }
  }
};

// Fills in what can be measured; returns why the rest cannot.
std::string Measure(const fs::path& mesh_path, const ScanAlignment& alignment, const ScanTruth& truth,
                    const MeshEvaluationOptions& options, uint64_t seed, MeshFigures* figures) {
  std::error_code ec;
  if (!fs::exists(mesh_path, ec)) return "no " + mesh_path.string();
  TriangleMesh mesh;
  try {
    mesh = ReadPlyMesh(mesh_path);
  } catch (const UserError& error) {
    return error.what();
  }
  figures->faces.values = {{"value", static_cast<double>(mesh.triangles.size())}};
  if (!alignment.truth_from_object.has_value()) return "no poses to align with: " + alignment.reason;
  SurfaceSamples samples = SampleSurface(mesh, options.num_samples, seed, kEstimateStream);
  figures->unusable.values = {{"value", static_cast<double>(samples.num_unusable_triangles)}};
  if (samples.points.empty()) return "the mesh has no surface";
  for (Vector3d& point : samples.points) point = *alignment.truth_from_object * point;

  const CropRegion region = MakeRegion(truth, options);
  EstimatedSurface estimate;
  estimate.points = Crop(samples.points, region);
  estimate.triangles = TrianglesInside(mesh, *alignment.truth_from_object, region);
  const Eigen::AlignedBox3d box = ObjectBox(truth);
  const auto num_outside = std::count_if(estimate.points.begin(), estimate.points.end(),
                                         [&](const Vector3d& point) { return !box.contains(point); });
  figures->outside.values = {
      {"value", 100.0 * static_cast<double>(num_outside) / static_cast<double>(samples.points.size())}};
  if (estimate.points.empty()) return "the mesh has no surface in the region that counts";

  TruthSurfaceOptions truth_options;
  truth_options.num_samples = options.num_truth_samples;
  truth_options.seed = seed;
  const TruthSurface surface = MakeTruthSurface(truth.object, truth.disc.value_or(TriangleMesh()),
                                                TrainViews(truth.scene), region, truth_options);
  figures->seen.values = {{"value", 100 * surface.seen_share}};
  std::vector<double> thresholds;
  for (const double percent : options.thresholds_pct) thresholds.push_back(percent / 100 * truth.diameter);
  const std::optional<SurfaceErrors> errors = CompareSurfaces(estimate, surface, thresholds);
  if (!errors.has_value()) return "the true surface has no part that counts";

  figures->exact.Fill(*errors, truth.diameter);
  // Where there are distances to triangles there are distances to samples.
  figures->sampled.Fill(*CompareSamples(estimate.points, surface, thresholds), truth.diameter);
  return "";
}

}  // namespace

OptionCheck MeshEvaluationOptions::Check() const {
  const auto list = [](const std::vector<double>& values) {
    return fmt::format("{}", fmt::join(values, ","));
  };
  if (num_samples < 1 || num_samples > 100'000'000) {
    return OptionFault{"num_samples", std::to_string(num_samples), "1 <= num_samples <= 100000000"};
  }
  if (num_truth_samples < 1 || num_truth_samples > 100'000'000) {
    return OptionFault{"num_truth_samples", std::to_string(num_truth_samples),
                       "1 <= num_truth_samples <= 100000000"};
  }
  for (const double threshold : thresholds_pct) {
    if (!(threshold > 0)) return OptionFault{"thresholds_pct", list(thresholds_pct), "all > 0"};
  }
  if (!crop_min.empty() && crop_min.size() != 3)
    return OptionFault{"crop_min", list(crop_min), "three numbers"};
  if (crop_max.size() != crop_min.size()) {
    return OptionFault{"crop_max", list(crop_max), "three numbers, if and only if crop_min has"};
  }
  for (size_t i = 0; i < crop_min.size(); ++i) {
    if (!(crop_min[i] < crop_max[i])) return OptionFault{"crop_max", list(crop_max), "each above crop_min's"};
  }
  return std::nullopt;
}

void EvaluateMesh(const fs::path& mesh_path, const ScanAlignment& alignment, const ScanTruth& truth,
                  const MeshEvaluationOptions& options, uint64_t seed, Figures* figures) {
  MeshFigures mesh_figures(options.thresholds_pct);
  const std::string missing = Measure(mesh_path, alignment, truth, options, seed, &mesh_figures);
  mesh_figures.Finish(missing, figures);
}

}  // namespace s2gs
