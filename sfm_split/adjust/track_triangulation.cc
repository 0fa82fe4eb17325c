#include "sfm_split/adjust/track_triangulation.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <numeric>
#include <optional>
#include <random>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/number_text.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/base/sampson_error.h"
#include "sfm_split/base/union_find.h"
#include "sfm_split/scene/projection_jacobians.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr int kMaxPointsOfTrack =
    4;  // that one track is taken apart into, where wrong matches joined several
// Keypoints that are looked at: chains of wrong matches join thousands.
constexpr size_t kMaxTrackLength = 2000;
constexpr int kSetsAtOnce = 64;         // that a thread makes points of: about a millisecond
constexpr int64_t kEdgesAtOnce = 4096;  // whose support a thread counts: likewise

struct Ray {
  bool is_wanted = false;
  Vector3d in_cam;   // z = 1; zero where there is none
  Vector3d in_body;  // unit
};

// Disjoint sets of keypoints, at most one an image.
class Tracks {
 public:
  explicit Tracks(const std::vector<int>& image_of)
      : image_of_(image_of), sets_(image_of.size()), images_(image_of.size()) {}
  /// The first of its keypoints.
  uint32_t Root(uint32_t k) { return sets_.Root(k); }
  // Unless both have a keypoint of one image: then a match is wrong.
  void Join(uint32_t a, uint32_t b) {
    a = sets_.Root(a);
    b = sets_.Root(b);
    if (a == b) return;
    for (const uint32_t k : {a, b}) {
      if (images_[k].empty()) images_[k] = {image_of_[k]};
    }
    std::vector<int> all;
    all.reserve(images_[a].size() + images_[b].size());
    std::merge(images_[a].begin(), images_[a].end(), images_[b].begin(), images_[b].end(),
               std::back_inserter(all));
    if (std::adjacent_find(all.begin(), all.end()) != all.end()) return;
    sets_.Join(a, b);
    images_[std::max(a, b)].clear();
    images_[std::min(a, b)] = std::move(all);
  }

 private:
  const std::vector<int>& image_of_;
  UnionFind sets_;
  std::vector<std::vector<int>> images_;  // of a root's set, ascending; none: its own
};

class Triangulator {
 public:
  Triangulator(const std::vector<PosedImage>& images, const std::vector<Keypoints>& keypoints,
               const TrackOptions& options)
      : images_(images), keypoints_(keypoints), options_(options), rng_(options.random_seed) {
    centres_.resize(images.size());
    rays_.resize(images.size());
    first_.resize(images.size() + 1, 0);
    for (size_t i = 0; i < images.size(); ++i) {
      first_[i + 1] = first_[i] + static_cast<uint32_t>(keypoints[i].size());
      rays_[i].resize(keypoints[i].size());
      if (images[i].is_posed) centres_[i] = CameraCentre(images[i].cam_from_body);
    }
  }

  std::vector<TrackPoint> Run(const std::vector<ImagePairMatches>& pairs) {
    FindRays(pairs);
    std::vector<Edge> edges = EdgesOf(pairs);
    std::sort(edges.begin(), edges.end());
    edges.erase(std::unique(edges.begin(), edges.end()), edges.end());
    // Matches that a third keypoint confirms come first.
    std::vector<std::pair<int, Edge>> by_support = SupportOf(edges);
    std::sort(by_support.begin(), by_support.end());
    std::vector<int> image_of;
    image_of.reserve(first_.back());
    for (size_t i = 0; i < images_.size(); ++i)
      image_of.insert(image_of.end(), keypoints_[i].size(), static_cast<int>(i));
    Tracks sets(image_of);
    std::vector<bool> is_matched(first_.back(), false);
    for (const auto& [support, edge] : by_support) {
      sets.Join(edge.first, edge.second);
      is_matched[edge.first] = is_matched[edge.second] = true;
    }
    // Keypoints by set, in their order.
    std::vector<std::pair<uint32_t, uint32_t>> by_set;
    for (uint32_t k = 0; k < first_.back(); ++k) {
      if (is_matched[k]) by_set.emplace_back(sets.Root(k), k);
    }
    std::sort(by_set.begin(), by_set.end());
    return PointsOf(by_set);
  }

 private:
  using Edge = std::pair<uint32_t, uint32_t>;  // two keypoints by number, ascending

  TrackElement ElementOf(uint32_t k) const {
    const auto image = std::upper_bound(first_.begin(), first_.end(), k) - first_.begin() - 1;
    return {static_cast<int>(image), k - first_[static_cast<size_t>(image)]};
  }
  Vector2d Pixel(const TrackElement& element) const {
    return keypoints_[static_cast<size_t>(element.image)][element.keypoint].cast<double>();
  }
  const Ray& RayOf(const TrackElement& element) const {
    return rays_[static_cast<size_t>(element.image)][element.keypoint];
  }
  bool ArePosed(const ImagePairMatches& pair) const {
    return pair.image1 != pair.image2 && images_[static_cast<size_t>(pair.image1)].is_posed &&
           images_[static_cast<size_t>(pair.image2)].is_posed;
  }

  // Of all keypoints that are matched.
  void FindRays(const std::vector<ImagePairMatches>& pairs) {
    for (const ImagePairMatches& pair : pairs) {
      if (!ArePosed(pair)) continue;
      for (const FeatureMatch& match : pair.matches) {
        rays_[static_cast<size_t>(pair.image1)][match.point2D_idx1].is_wanted = true;
        rays_[static_cast<size_t>(pair.image2)][match.point2D_idx2].is_wanted = true;
      }
    }
    ParallelFor(static_cast<int64_t>(images_.size()), 0, [&](int64_t image) {
      const auto i = static_cast<size_t>(image);
      for (size_t k = 0; k < rays_[i].size(); ++k) {
        Ray& ray = rays_[i][k];
        if (!ray.is_wanted) continue;
        const std::optional<Vector3d> in_cam =
            UnprojectFromImage(*images_[i].camera, keypoints_[i][k].cast<double>());
        ray.in_cam = in_cam.value_or(Vector3d::Zero());
        ray.in_body = images_[i].cam_from_body.rotation.conjugate() * ray.in_cam;
        if (in_cam) ray.in_body.normalize();
      }
    });
  }

  std::vector<Edge> EdgesOf(const std::vector<ImagePairMatches>& pairs) const {
    std::vector<std::vector<Edge>> of_pairs(pairs.size());
    ParallelFor(static_cast<int64_t>(pairs.size()), 0, [&](int64_t p) {
      const auto at = static_cast<size_t>(p);
      if (ArePosed(pairs[at])) AddEdges(pairs[at], &of_pairs[at]);
    });
    std::vector<Edge> edges;
    for (const std::vector<Edge>& of_pair : of_pairs)
      edges.insert(edges.end(), of_pair.begin(), of_pair.end());
    return edges;
  }

  // Matches on their epipolar lines.
  void AddEdges(const ImagePairMatches& pair, std::vector<Edge>* edges) const {
    const PosedImage& image1 = images_[static_cast<size_t>(pair.image1)];
    const PosedImage& image2 = images_[static_cast<size_t>(pair.image2)];
    const Rigid3 second_from_first = image2.cam_from_body * image1.cam_from_body.Inverse();
    const Matrix3d essential =
        CrossMatrix<double>(second_from_first.translation) * second_from_first.rotation.toRotationMatrix();
    const double focal = 0.25 * (FocalLengths(*image1.camera).sum() + FocalLengths(*image2.camera).sum());
    for (const FeatureMatch& match : pair.matches) {
      const TrackElement a{pair.image1, match.point2D_idx1};
      const TrackElement b{pair.image2, match.point2D_idx2};
      const Vector3d u = RayOf(a).in_cam;
      const Vector3d v = RayOf(b).in_cam;
      if (u.z() == 0 || v.z() == 0) continue;
      const Vector3d line2 = essential * u;
      const Vector3d line1 = essential.transpose() * v;
      const double squared = line1.head<2>().squaredNorm() + line2.head<2>().squaredNorm();
      const double error = focal * std::abs(v.dot(line2));
      if (!(error * error <= options_.max_error_px * options_.max_error_px * squared)) continue;
      const uint32_t k1 = first_[static_cast<size_t>(a.image)] + a.keypoint;
      const uint32_t k2 = first_[static_cast<size_t>(b.image)] + b.keypoint;
      edges->emplace_back(std::min(k1, k2), std::max(k1, k2));
    }
  }

  // How many keypoints both of an edge's are matched with, less than 0, with the edge.
  // \param edges  each once.
  std::vector<std::pair<int, Edge>> SupportOf(const std::vector<Edge>& edges) const {
    std::vector<size_t> begin(first_.back() + 1, 0);  // of a keypoint's neighbours
    for (const auto& [a, b] : edges) {
      ++begin[a + 1];
      ++begin[b + 1];
    }
    std::partial_sum(begin.begin(), begin.end(), begin.begin());
    std::vector<uint32_t> neighbours(begin.back());
    std::vector<size_t> next = begin;
    // In their order: those before a keypoint, by these, then those after it.
    for (const auto& [a, b] : edges) neighbours[next[b]++] = a;
    for (const auto& [a, b] : edges) neighbours[next[a]++] = b;
    std::vector<std::pair<int, Edge>> by_support(edges.size());
    ParallelFor(static_cast<int64_t>(edges.size()), 0, kEdgesAtOnce, [&](int64_t e) {
      const Edge& edge = edges[static_cast<size_t>(e)];
      size_t i = begin[edge.first], j = begin[edge.second];
      int support = 0;
      while (i < begin[edge.first + 1] && j < begin[edge.second + 1]) {
        support += neighbours[i] == neighbours[j] ? 1 : 0;
        const bool is_first_behind = neighbours[i] <= neighbours[j];
        const bool is_second_behind = neighbours[j] <= neighbours[i];
        i += is_first_behind ? 1 : 0;
        j += is_second_behind ? 1 : 0;
      }
      by_support[static_cast<size_t>(e)] = {-support, edge};
    });
    return by_support;
  }

  // \param by_set  keypoints with their sets, by these.
  std::vector<TrackPoint> PointsOf(const std::vector<std::pair<uint32_t, uint32_t>>& by_set) {
    std::vector<std::vector<TrackElement>> sets;
    for (size_t begin = 0; begin < by_set.size();) {
      size_t end = begin;
      while (end < by_set.size() && by_set[end].first == by_set[begin].first) ++end;
      std::vector<TrackElement>& elements = sets.emplace_back();
      elements.reserve(std::min(end - begin, kMaxTrackLength));
      for (size_t k = begin; k < end && elements.size() < kMaxTrackLength; ++k) {
        elements.push_back(ElementOf(by_set[k].second));
      }
      begin = end;
    }
    std::vector<std::vector<TrackPoint>> points_of(sets.size());
    // Those that draw numbers come one after another.
    ParallelFor(static_cast<int64_t>(sets.size()), 0, kSetsAtOnce, [&](int64_t i) {
      const auto set = static_cast<size_t>(i);
      if (!IsDrawn(sets[set].size())) Extract(std::move(sets[set]), &points_of[set]);
    });
    std::vector<TrackPoint> points;
    for (size_t set = 0; set < sets.size(); ++set) {
      if (IsDrawn(sets[set].size())) Extract(std::move(sets[set]), &points_of[set]);
      std::move(points_of[set].begin(), points_of[set].end(), std::back_inserter(points));
    }
    return points;
  }

  // Whether so many keypoints have more pairs than are tried.
  bool IsDrawn(size_t n) const { return n * (n - 1) / 2 > static_cast<size_t>(options_.max_hypotheses); }

  // Where two rays pass closest; nothing when they are parallel or pass behind a camera.
  std::optional<Vector3d> Intersect(const TrackElement& a, const TrackElement& b) {
    const Vector3d& u = RayOf(a).in_body;
    const Vector3d& v = RayOf(b).in_body;
    const double cosine = u.dot(v);
    const double determinant = 1 - cosine * cosine;
    if (!(determinant > sine_squared_)) return std::nullopt;
    const Vector3d gap = centres_[static_cast<size_t>(b.image)] - centres_[static_cast<size_t>(a.image)];
    const double s = (u.dot(gap) - cosine * v.dot(gap)) / determinant;
    const double t = (cosine * u.dot(gap) - v.dot(gap)) / determinant;
    if (!(s > 0) || !(t > 0)) return std::nullopt;
    return 0.5 *
           (centres_[static_cast<size_t>(a.image)] + s * u + centres_[static_cast<size_t>(b.image)] + t * v);
  }

  // The keypoints that a point explains, the best of each image.
  double Explain(const std::vector<TrackElement>& elements, const Vector3d& x, std::vector<size_t>* inliers) {
    inliers->clear();
    double score = 0;
    double last = 0;
    for (size_t k = 0; k < elements.size(); ++k) {
      const double error =
          ReprojectionErrorPx(images_[static_cast<size_t>(elements[k].image)], x, Pixel(elements[k]));
      const double ratio = error / options_.max_error_px;
      const double gain = 1 - ratio * ratio;
      if (!(gain > 0)) continue;
      if (!inliers->empty() && elements[inliers->back()].image == elements[k].image) {
        if (gain <= last) continue;
        inliers->pop_back();
        score -= last;
      }
      inliers->push_back(k);
      score += gain;
      last = gain;
    }
    return score;
  }

  bool HasParallax(const std::vector<TrackElement>& track, const Vector3d& x) const {
    for (size_t a = 1; a < track.size(); ++a) {
      const Vector3d u = (centres_[static_cast<size_t>(track[a].image)] - x).normalized();
      for (size_t b = 0; b < a; ++b) {
        const Vector3d v = (centres_[static_cast<size_t>(track[b].image)] - x).normalized();
        if (u.cross(v).squaredNorm() > sine_squared_) return true;
      }
    }
    return false;
  }

  void Extract(std::vector<TrackElement> elements, std::vector<TrackPoint>* points) {
    std::vector<size_t> inliers;
    std::vector<size_t> best_inliers;
    for (int round = 0; round < kMaxPointsOfTrack && elements.size() >= 2; ++round) {
      double best = 0;
      Vector3d x = Vector3d::Zero();
      const auto attempt = [&](size_t a, size_t b) {
        if (elements[a].image == elements[b].image) return;
        const std::optional<Vector3d> candidate = Intersect(elements[a], elements[b]);
        if (!candidate) return;
        const double score = Explain(elements, *candidate, &inliers);
        if (score <= best || inliers.size() < 2) return;
        best = score;
        x = *candidate;
        best_inliers = inliers;
      };
      const size_t n = elements.size();
      if (!IsDrawn(n)) {
        for (size_t a = 1; a < n; ++a) {
          for (size_t b = 0; b < a; ++b) attempt(a, b);
        }
      } else {
        for (int k = 0; k < options_.max_hypotheses; ++k) {
          const size_t a = rng_() % n;
          const size_t b = rng_() % n;
          if (a != b) attempt(a, b);
        }
      }
      if (best_inliers.size() < 2 || best == 0) return;
      TrackPoint point;
      for (int pass = 0; pass < 2; ++pass) {
        point.track.clear();
        for (const size_t k : best_inliers) point.track.push_back(elements[k]);
        Vector3d refined = x;
        if (!RefinePoint(images_, keypoints_, point.track, &refined)) break;
        const double score = Explain(elements, refined, &inliers);
        if (score < best || inliers.size() < 2) break;
        best = score;
        x = refined;
        const bool is_same = inliers == best_inliers;
        best_inliers = inliers;
        if (is_same) break;
      }
      point.track.clear();
      point.x_in_body = x;
      for (const size_t k : best_inliers) {
        point.track.push_back(elements[k]);
        point.mean_error_px +=
            ReprojectionErrorPx(images_[static_cast<size_t>(elements[k].image)], x, Pixel(elements[k]));
      }
      point.mean_error_px /= static_cast<double>(point.track.size());
      for (auto k = best_inliers.rbegin(); k != best_inliers.rend(); ++k) {
        elements.erase(elements.begin() + static_cast<std::ptrdiff_t>(*k));
      }
      best_inliers.clear();
      if (HasParallax(point.track, x)) points->push_back(std::move(point));
    }
  }

  const std::vector<PosedImage>& images_;
  const std::vector<Keypoints>& keypoints_;
  const TrackOptions& options_;
  std::mt19937 rng_;
  double sine_squared_ = std::pow(std::sin(options_.min_triangulation_deg * kDegree), 2);
  std::vector<Vector3d> centres_;
  std::vector<std::vector<Ray>> rays_;
  std::vector<uint32_t> first_;  // number of an image's first keypoint
};

}  // namespace

OptionCheck TrackOptions::Check() const {
  const auto fault = [](const char* field, double value, const char* bound) {
    return OptionFault{field, NumberText(value), bound};
  };
  if (!(max_error_px > 0)) return fault("max_error_px", max_error_px, "max_error_px > 0");
  if (!(min_triangulation_deg > 0 && min_triangulation_deg < 90)) {
    return fault("min_triangulation_deg", min_triangulation_deg, "0 < min_triangulation_deg < 90");
  }
  if (max_hypotheses < 1) return fault("max_hypotheses", max_hypotheses, "max_hypotheses >= 1");
  return std::nullopt;
}

std::vector<TrackPoint> TriangulateTracks(const std::vector<PosedImage>& images,
                                          const std::vector<Keypoints>& keypoints,
                                          const std::vector<ImagePairMatches>& pairs,
                                          const TrackOptions& options) {
  S2GS_INVARIANT(!options.Check() && images.size() == keypoints.size());
  return Triangulator(images, keypoints, options).Run(pairs);
}

double ReprojectionErrorPx(const PosedImage& image, const Vector3d& x_in_body, const Vector2d& xy) {
  Vector2d projected;
  if (!ProjectWithJacobians(image.camera->model, image.camera->params.data(), image.cam_from_body * x_in_body,
                            &projected, nullptr, nullptr)) {
    return std::numeric_limits<double>::infinity();
  }
  return (projected - xy).norm();
}

bool ProjectPoint(const PosedImage& image, const Vector3d& x_in_body, Vector2d* xy,
                  Eigen::Matrix<double, 2, 3>* by_x) {
  Eigen::Matrix<double, 2, 3> by_cam;
  if (!ProjectWithJacobians(image.camera->model, image.camera->params.data(), image.cam_from_body * x_in_body,
                            xy, &by_cam, nullptr)) {
    return false;
  }
  *by_x = by_cam * image.cam_from_body.rotation.toRotationMatrix();
  return true;
}

PairOfPoses::PairOfPoses(const PosedImage& image1, const PosedImage& image2)
    : second_from_first_(image2.cam_from_body * image1.cam_from_body.Inverse()),
      focal_px_(0.25 * (FocalLengths(*image1.camera).sum() + FocalLengths(*image2.camera).sum())) {}

double PairOfPoses::ErrorPx(const Vector3d& ray1, const Vector3d& ray2) const {
  const Vector3d line2 = second_from_first_.translation.cross(second_from_first_.rotation * ray1);
  const Vector3d line1 =
      -(second_from_first_.rotation.conjugate() * second_from_first_.translation.cross(ray2));
  return focal_px_ * std::abs(SampsonError<double>(line1, line2, ray2));
}

double MatchErrorPx(const PosedImage& image1, const PosedImage& image2, const Vector2d& xy1,
                    const Vector2d& xy2) {
  const std::optional<Vector3d> u = UnprojectFromImage(*image1.camera, xy1);
  const std::optional<Vector3d> v = UnprojectFromImage(*image2.camera, xy2);
  if (!u || !v) return std::numeric_limits<double>::infinity();
  return PairOfPoses(image1, image2).ErrorPx(*u, *v);
}

bool RefinePoint(const std::vector<PosedImage>& images, const std::vector<Keypoints>& keypoints,
                 const std::vector<TrackElement>& track, Vector3d* x_in_body) {
  Vector3d x = *x_in_body;
  for (int iteration = 0; iteration < 5; ++iteration) {
    Matrix3d normal = Matrix3d::Zero();
    Vector3d right = Vector3d::Zero();
    for (const TrackElement& element : track) {
      const PosedImage& image = images[static_cast<size_t>(element.image)];
      Vector2d xy;
      Eigen::Matrix<double, 2, 3> jacobian;
      if (!ProjectPoint(image, x, &xy, &jacobian)) return false;
      const Vector2d residual =
          xy - keypoints[static_cast<size_t>(element.image)][element.keypoint].cast<double>();
      normal += jacobian.transpose() * jacobian;
      right -= jacobian.transpose() * residual;
    }
    normal.diagonal() *= 1 + 1e-9;
    const Vector3d step = normal.ldlt().solve(right);
    if (!step.allFinite()) return false;
    x += step;
    if (step.squaredNorm() <= 1e-18 * x.squaredNorm()) break;
  }
  *x_in_body = x;
  return true;
}

}  // namespace s2gs
