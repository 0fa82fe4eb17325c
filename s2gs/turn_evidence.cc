#include "s2gs/turn_evidence.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

#include "s2gs/core/knn.h"
#include "s2gs/image/bilinear.h"
#include "s2gs/image/photos.h"
#include "s2gs/image/picture_noise.h"
#include "s2gs/image/turned_picture.h"
#include "s2gs/kernel/foreground.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

constexpr int kMaxSide = 400;        // of the pictures that are compared [px]: they need not be sharp.
constexpr size_t kMinPhotos = 10;    // of a camera: fewer cannot pass the sign test.
constexpr size_t kMaxPhotos = 48;    // of which so many, evenly chosen, see what there is to see.
constexpr size_t kMinUncovered = 3;  // photos that show the background, for a median.
constexpr double kSameCamera = 0.5;  // how far the picture of the table may move [px].
constexpr int kCoverMargin = 2;      // [px], about what is covered: a rendering's borders are soft.
constexpr float kPoseError = 0.5F;   // [px]
constexpr int kPatchRadius = 3;      // [px], of the texture that is recognised.
// Correlations of a texture of kTextureFactor are .9 but for chance, and those of other textures rarely this.
constexpr float kCorrelation = 0.7F;
constexpr float kMinWeight = 0.1F;          // of a Gaussian in some pixel: it is seen.
constexpr size_t kViewsAtOnce = 32;         // of which is held what a backend saw of all Gaussians.
constexpr int kNeighbours = 8;              // that are judged together.
constexpr double kDeviations = 3.09;        // of the sign test: chance passes once in a thousand.
constexpr int64_t kGaussiansAtOnce = 1000;  // whose votes one thread counts

// All pixels of which one within `margin` along both axes is set.
std::vector<uint8_t> Widened(const std::vector<uint8_t>& inside, int width, int height, int margin) {
  std::vector<uint8_t> along_rows(inside.size(), 0);
  for (int y = 0; y < height; ++y) {
    const size_t row = static_cast<size_t>(y) * width;
    for (int x = 0; x < width; ++x) {
      if (inside[row + x] == 0) continue;
      for (int u = std::max(0, x - margin); u <= std::min(width - 1, x + margin); ++u)
        along_rows[row + u] = 1;
    }
  }
  std::vector<uint8_t> wide(inside.size(), 0);
  for (int y = 0; y < height; ++y) {
    uint8_t* const to = wide.data() + static_cast<size_t>(y) * width;
    for (int v = std::max(0, y - margin); v <= std::min(height - 1, y + margin); ++v) {
      const uint8_t* const from = along_rows.data() + static_cast<size_t>(v) * width;
      for (int x = 0; x < width; ++x) to[x] |= from[x];
    }
  }
  return wide;
}

// Whether what stands still about the table lies in the same pixels.
bool IsSameCamera(const TrainingScene& scene, const PinholeView& a, const PinholeView& b) {
  if (a.width != b.width || a.height != b.height) return false;
  if (!scene.region) return false;
  for (int i = -1; i < 6; ++i) {
    Eigen::Vector3d x = scene.region->axis.point;
    if (i >= 0) x[i / 2] += i % 2 == 0 ? scene.region->radius : -scene.region->radius;
    const std::optional<Eigen::Vector2d> in_a = PixelOf(a, a.cam_from_world * x);
    const std::optional<Eigen::Vector2d> in_b = PixelOf(b, b.cam_from_world * x);
    if (!in_a || !in_b || !((*in_a - *in_b).norm() < kSameCamera)) return false;
  }
  return true;
}

PinholeView ReducedView(const PinholeView& view) {
  const int side = std::max(view.width, view.height);
  if (side <= kMaxSide) return view;
  const double scale = static_cast<double>(kMaxSide) / side;
  return ResizeView(view, std::max(1, static_cast<int>(view.width * scale)),
                    std::max(1, static_cast<int>(view.height * scale)));
}

// Sums over the patches about the pixels of one row of two grey pictures. Whole numbers: exact in any order.
struct PatchSums {
  int32_t a = 0, b = 0, aa = 0, bb = 0, ab = 0;

  void Add(int in_a, int in_b, int sign) {
    a += sign * in_a;
    b += sign * in_b;
    aa += sign * in_a * in_a;
    bb += sign * in_b * in_b;
    ab += sign * in_a * in_b;
  }
  void Add(const PatchSums& other, int sign) {
    a += sign * other.a;
    b += sign * other.b;
    aa += sign * other.aa;
    bb += sign * other.bb;
    ab += sign * other.ab;
  }
};

// Those of a row's columns, moved from row to row.
class PatchColumns {
 public:
  PatchColumns(const std::vector<uint8_t>& a, const std::vector<uint8_t>& b, int width)
      : a_(a), b_(b), columns_(static_cast<size_t>(width)) {
    for (int y = 0; y < 2 * kPatchRadius; ++y) AddRow(y, 1);
  }

  /// The columns about row y; rows in order, from kPatchRadius on.
  const std::vector<PatchSums>& Row(int y) {
    if (y > kPatchRadius) AddRow(y - kPatchRadius - 1, -1);
    AddRow(y + kPatchRadius, 1);
    return columns_;
  }

 private:
  void AddRow(int y, int sign) {
    const size_t row = static_cast<size_t>(y) * columns_.size();
    for (size_t x = 0; x < columns_.size(); ++x) columns_[x].Add(a_[row + x], b_[row + x], sign);
  }

  const std::vector<uint8_t>& a_;
  const std::vector<uint8_t>& b_;
  std::vector<PatchSums> columns_;
};

// Correlation of the patches about a pixel, and the standard deviation of the first.
struct Likeness {
  float correlation = 0;
  float deviation = 0;
};

Likeness LikenessOf(const PatchSums& sums) {
  constexpr double kCount = (2 * kPatchRadius + 1) * (2 * kPatchRadius + 1);
  const double a = sums.a;
  const double b = sums.b;
  const double var_a = std::max(0.0, sums.aa - a * a / kCount);
  const double var_b = std::max(0.0, sums.bb - b * b / kCount);
  const double product = std::sqrt(var_a * var_b);
  Likeness likeness;
  likeness.deviation = static_cast<float>(std::sqrt(var_a / kCount));
  if (product > 0) likeness.correlation = static_cast<float>((sums.ab - a * b / kCount) / product);
  return likeness;
}

std::vector<uint32_t> RotatingOnes(const Placement& all) {
  std::vector<uint32_t> rotating;
  for (size_t i = 0; i < all.size(); ++i) {
    const float* x = all.centre.data() + 3 * i;
    const bool is_finite = std::isfinite(x[0]) && std::isfinite(x[1]) && std::isfinite(x[2]);
    if (is_finite && IsForeground(all.foreground_logit[i])) rotating.push_back(static_cast<uint32_t>(i));
  }
  return rotating;
}

// Of what the rotating part alone looks like: which of its Gaussians each view sees, and where it may hide
// the background.
struct RotatingAlone {
  std::vector<std::vector<uint8_t>> is_visible;  // by view and Gaussian; empty when the backend cannot tell.
  std::vector<std::vector<uint8_t>> covered;     // by view and pixel, with a margin.
  std::vector<std::vector<uint8_t>> opaque;      // by view and pixel: what a mask has.
};

RotatingAlone LookAlone(const std::vector<uint32_t>& rotating, const std::vector<PinholeView>& views,
                        Backend* backend) {
  RotatingAlone alone;
  alone.is_visible.resize(views.size());
  alone.covered.resize(views.size());
  alone.opaque.resize(views.size());
  // The backend works while nothing else does, and the other way round: a few views at a time, to hold
  // little.
  for (size_t first = 0; first < views.size(); first += kViewsAtOnce) {
    const size_t end = std::min(first + kViewsAtOnce, views.size());
    std::vector<BodySight> sights;
    for (size_t v = first; v < end; ++v) {
      sights.push_back(backend->SeeBody(views[v], DrawnBody::kForeground, kMinWeight));
      if (sights.back().is_seen.empty()) return {};
    }
    ParallelFor(static_cast<int64_t>(end - first), 0, [&](int64_t i) {
      const BodySight& sight = sights[static_cast<size_t>(i)];
      const size_t v = first + static_cast<size_t>(i);
      alone.is_visible[v].reserve(rotating.size());
      for (const uint32_t k : rotating) alone.is_visible[v].push_back(sight.is_seen[k]);
      std::vector<uint8_t> inside;
      inside.reserve(sight.alpha.size());
      alone.opaque[v].reserve(sight.alpha.size());
      for (const float alpha : sight.alpha) {
        inside.push_back(alpha > kMinWeight ? 1 : 0);
        alone.opaque[v].push_back(alpha > 0.5F ? 1 : 0);
      }
      alone.covered[v] = Widened(inside, views[v].width, views[v].height, kCoverMargin);
    });
  }
  return alone;
}

}  // namespace

bool SightVotes::IsStanding() const {
  return background > other && background - other > kDeviations * std::sqrt(background + other);
}

TurnEvidence::TurnEvidence(const TrainingScene& scene) {
  std::vector<std::vector<const ScenePhoto*>> groups;
  for (const ScenePhoto& photo : scene.photos) {
    if (photo.held_out || photo.image.pixels.empty()) continue;
    const auto same = std::find_if(groups.begin(), groups.end(), [&](const auto& group) {
      const PinholeView& first = group.front()->view;
      return IsSameCamera(scene, first, TurnedTo(first, photo.view));
    });
    if (same != groups.end()) {
      same->push_back(&photo);
    } else {
      groups.push_back({&photo});
    }
  }
  for (const std::vector<const ScenePhoto*>& group : groups) {
    if (group.size() < kMinPhotos) continue;
    Camera camera;
    camera.first = pictures_.size();
    const size_t count = std::min(group.size(), kMaxPhotos);
    for (size_t i = 0; i < count; ++i) {
      const ScenePhoto& photo = *group[i * group.size() / count];
      const PinholeView view = ReducedView(photo.view);
      views_.push_back(view);
      pictures_.push_back(ResizeByArea(photo.image, view.width, view.height));
      is_outside_.emplace_back(static_cast<size_t>(view.width) * view.height, 0);
      // What has hardly moved stays as it is, and as sharp.
      if (IsSameCamera(scene, group.front()->view, photo.view)) continue;
      views_.back() = TurnedTo(group.front()->view, view);
      pictures_.back() = TurnedPicture(view, views_.back(), pictures_.back(), &is_outside_.back());
    }
    camera.end = pictures_.size();
    const PictureNoise noise = MeasurePictureNoise(&pictures_[camera.first], count);
    camera.noise = noise.of_grey;
    camera.tolerance = noise.tolerance;
    cameras_.push_back(camera);
  }
}

std::vector<std::vector<PixelSight>> TurnEvidence::Look(
    const std::vector<std::vector<uint8_t>>& covered) const {
  std::vector<std::vector<PixelSight>> sights(views_.size());
  for (const Camera& camera : cameras_) {
    std::vector<uint8_t> is_seen;
    const Image8 background = Background(camera, covered, &is_seen);
    const std::vector<uint8_t> behind = GreyImage(background).pixels;
    ParallelFor(static_cast<int64_t>(camera.end - camera.first), 0, [&](int64_t i) {
      const size_t picture = camera.first + static_cast<size_t>(i);
      sights[picture] = Compare(camera, pictures_[picture], background, behind, is_seen);
      for (size_t p = 0; p < sights[picture].size(); ++p) {
        if (is_outside_[picture][p] != 0) sights[picture][p] = PixelSight::kNeverFree;
      }
    });
  }
  return sights;
}

// Medians of the photos that leave a pixel free.
Image8 TurnEvidence::Background(const Camera& camera, const std::vector<std::vector<uint8_t>>& covered,
                                std::vector<uint8_t>* is_seen) const {
  Image8 background = pictures_[camera.first];
  const auto width = static_cast<size_t>(background.width);
  is_seen->assign(width * background.height, 0);
  ParallelFor(background.height, 0, [&](int64_t y) {
    std::array<std::vector<uint8_t>, 3> channels;
    for (size_t p = width * static_cast<size_t>(y); p < width * static_cast<size_t>(y + 1); ++p) {
      for (std::vector<uint8_t>& channel : channels) channel.clear();
      for (size_t i = camera.first; i < camera.end; ++i) {
        if (covered[i][p] != 0 || is_outside_[i][p] != 0) continue;
        for (int c = 0; c < 3; ++c) channels[c].push_back(pictures_[i].pixels[3 * p + c]);
      }
      if (channels[0].size() < kMinUncovered) continue;
      (*is_seen)[p] = 1;
      for (int c = 0; c < 3; ++c) background.pixels[3 * p + c] = UpperMedian(channels[c]);
    }
  });
  return background;
}

std::vector<PixelSight> TurnEvidence::Compare(const Camera& camera, const Image8& picture,
                                              const Image8& background, const std::vector<uint8_t>& behind,
                                              const std::vector<uint8_t>& is_seen) {
  const int width = picture.width;
  const int height = picture.height;
  std::vector<PixelSight> sights(static_cast<size_t>(width) * height, PixelSight::kNeverFree);
  if (width <= 2 * kPatchRadius || height <= 2 * kPatchRadius) return sights;
  const std::vector<uint8_t> grey = GreyImage(picture).pixels;
  PatchColumns patches(behind, grey, width);
  for (int y = kPatchRadius; y < height - kPatchRadius; ++y) {
    const std::vector<PatchSums>& columns = patches.Row(y);
    PatchSums sums;
    for (int x = 0; x < 2 * kPatchRadius; ++x) sums.Add(columns[x], 1);
    for (int x = kPatchRadius; x < width - kPatchRadius; ++x) {
      sums.Add(columns[x + kPatchRadius], 1);
      if (x > kPatchRadius) sums.Add(columns[x - kPatchRadius - 1], -1);
      const size_t p = static_cast<size_t>(y) * width + x;
      if (is_seen[p] == 0) continue;
      sights[p] = PixelSight::kAlike;
      if (MostDifferentChannel(picture.Pixel(x, y), background.Pixel(x, y)) >
          camera.tolerance + kPoseError * SlopeAt(background, x, y)) {
        sights[p] = PixelSight::kOther;
        continue;
      }
      const Likeness likeness = LikenessOf(sums);
      if (likeness.deviation >= kTextureFactor * camera.noise && likeness.correlation >= kCorrelation) {
        sights[p] = PixelSight::kBackground;
      }
    }
  }
  return sights;
}

std::optional<SightShares> MeasureSights(const TurnEvidence& evidence, Backend* backend) {
  SightShares shares;
  if (!evidence.IsAvailable()) return shares;
  const std::vector<uint32_t> rotating = RotatingOnes(backend->GetPlacement());
  if (rotating.empty()) return std::nullopt;
  const RotatingAlone look = LookAlone(rotating, evidence.views(), backend);
  if (look.covered.empty()) return std::nullopt;
  const std::vector<std::vector<PixelSight>> sights = evidence.Look(look.covered);
  int64_t count = 0;
  for (size_t v = 0; v < sights.size(); ++v) {
    for (size_t p = 0; p < sights[v].size(); ++p) {
      if (look.opaque[v][p] == 0) continue;
      ++count;
      shares.other += sights[v][p] == PixelSight::kOther ? 1 : 0;
      shares.background += sights[v][p] == PixelSight::kBackground ? 1 : 0;
      shares.alike += sights[v][p] == PixelSight::kAlike ? 1 : 0;
      shares.never_free += sights[v][p] == PixelSight::kNeverFree ? 1 : 0;
    }
  }
  if (count == 0) return std::nullopt;
  shares.num_cameras = evidence.num_cameras();
  shares.num_photos = static_cast<int>(evidence.views().size());
  for (double* share : {&shares.other, &shares.background, &shares.alike, &shares.never_free}) {
    *share /= static_cast<double>(count);
  }
  return shares;
}

std::vector<uint32_t> FindStandingGaussians(const TurnEvidence& evidence, Backend* backend) {
  if (!evidence.IsAvailable()) return {};
  const Placement all = backend->GetPlacement();
  const std::vector<uint32_t> rotating = RotatingOnes(all);
  if (rotating.empty()) return {};
  const std::vector<PinholeView>& views = evidence.views();
  const RotatingAlone look = LookAlone(rotating, views, backend);
  if (look.covered.empty()) return {};
  std::vector<float> centres;
  centres.reserve(3 * rotating.size());
  for (const uint32_t i : rotating) {
    for (int axis = 0; axis < 3; ++axis) centres.push_back(all.centre[3 * i + axis]);
  }

  const std::vector<std::vector<PixelSight>> sights = evidence.Look(look.covered);
  const Neighbours near = FindNeighbours(centres, kNeighbours, 0);
  // By view and Gaussian: 1 something else than the background, -1 the background, 0 neither.
  std::vector<std::vector<int8_t>> seen(views.size());
  ParallelFor(static_cast<int64_t>(views.size()), 0, [&](int64_t view) {
    const auto v = static_cast<size_t>(view);
    seen[v].assign(rotating.size(), 0);
    for (size_t i = 0; i < rotating.size(); ++i) {
      const float* x = centres.data() + 3 * i;
      if (look.is_visible[v][i] == 0) continue;
      const std::optional<Eigen::Vector2d> pixel =
          PixelOf(views[v], views[v].cam_from_object * Eigen::Vector3d(x[0], x[1], x[2]));
      if (!pixel || !(pixel->x() >= 0 && pixel->y() >= 0 && pixel->x() < views[v].width &&
                      pixel->y() < views[v].height)) {
        continue;
      }
      const auto column = static_cast<size_t>(pixel->x());
      const PixelSight sight = sights[v][static_cast<size_t>(pixel->y()) * views[v].width + column];
      seen[v][i] = sight == PixelSight::kOther ? 1 : sight == PixelSight::kBackground ? -1 : 0;
    }
  });
  std::vector<SightVotes> votes(rotating.size());
  ParallelFor(static_cast<int64_t>(rotating.size()), 0, kGaussiansAtOnce, [&](int64_t gaussian) {
    const auto i = static_cast<size_t>(gaussian);
    for (const std::vector<int8_t>& in_view : seen) {
      int sum = in_view[i];
      for (int k = 0; k < near.k; ++k) sum += in_view[near.index[i * near.k + k]];
      if (sum > 0) ++votes[i].other;
      if (sum < 0) ++votes[i].background;
    }
  });
  std::vector<uint32_t> standing;
  for (size_t i = 0; i < rotating.size(); ++i) {
    if (votes[i].IsStanding()) standing.push_back(rotating[i]);
  }
  return standing;
}

}  // namespace s2gs
