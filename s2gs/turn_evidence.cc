#include "s2gs/turn_evidence.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdlib>
#include <utility>

#include "s2gs/core/knn.h"
#include "s2gs/image/photos.h"
#include "s2gs/kernel/foreground.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

constexpr int kMaxSide = 400;         // of the pictures that are compared [px]: they need not be sharp.
constexpr size_t kMinPhotos = 10;     // of a camera: fewer cannot pass the sign test.
constexpr size_t kMaxPhotos = 48;     // of which so many, evenly chosen, see what there is to see.
constexpr size_t kMinUncovered = 3;   // photos that show the background, for a median.
constexpr double kSameCamera = 0.5;   // how far the picture of the table may move [px].
constexpr int kCoverMargin = 2;       // [px], about what is covered: a rendering's borders are soft.
constexpr float kMinNoise = 0.5F;     // [grey levels], of rounding.
constexpr float kNoiseFactor = 3;     // standard deviations.
constexpr float kPoseError = 0.5F;    // [px]
constexpr int kPatchRadius = 3;       // [px], of the texture that is recognised.
constexpr float kTextureFactor = 2;   // a texture's standard deviation, in the noise's: then correlations
constexpr float kCorrelation = 0.7F;  // are .9 but for chance, and those of other textures rarely this.
constexpr float kMinWeight = 0.1F;    // of a Gaussian in some pixel: it is seen.
constexpr int kNeighbours = 8;        // that are judged together.
constexpr double kDeviations = 3.09;  // of the sign test: chance passes once in a thousand.
constexpr float kNormalMedian = 0.6745F;
constexpr size_t kNoiseStride = 7;  // of the pixels that noise is measured from.

float MostDifferent(const uint8_t* a, const uint8_t* b) {
  int most = 0;
  for (int c = 0; c < 3; ++c) most = std::max(most, std::abs(a[c] - b[c]));
  return static_cast<float>(most);
}

std::vector<float> GreyOf(const Image8& image) {
  std::vector<float> grey;
  grey.reserve(image.pixels.size() / 3);
  for (size_t i = 0; i + 2 < image.pixels.size(); i += 3) grey.push_back(GreyFromRgb(&image.pixels[i]));
  return grey;
}

// All pixels of which one within `margin` along both axes is set.
std::vector<uint8_t> Widened(const std::vector<uint8_t>& inside, int width, int height, int margin) {
  std::vector<uint8_t> wide(inside.size(), 0);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      if (inside[static_cast<size_t>(y) * width + x] == 0) continue;
      for (int v = std::max(0, y - margin); v <= std::min(height - 1, y + margin); ++v) {
        for (int u = std::max(0, x - margin); u <= std::min(width - 1, x + margin); ++u) {
          wide[static_cast<size_t>(v) * width + u] = 1;
        }
      }
    }
  }
  return wide;
}

// Nothing behind the camera.
bool Project(const PinholeView& view, const Rigid3& pose, const Eigen::Vector3d& x, Eigen::Vector2d* pixel) {
  const Eigen::Vector3d in_camera = pose * x;
  if (!(in_camera.z() > view.near_depth)) return false;
  *pixel = {view.cx + view.fx * in_camera.x() / in_camera.z(),
            view.cy + view.fy * in_camera.y() / in_camera.z()};
  return true;
}

// Whether what stands still about the table lies in the same pixels.
bool IsSameCamera(const TrainingScene& scene, const PinholeView& a, const PinholeView& b) {
  if (a.width != b.width || a.height != b.height) return false;
  if (!scene.region) return false;
  for (int i = -1; i < 6; ++i) {
    Eigen::Vector3d x = scene.region->axis.point;
    if (i >= 0) x[i / 2] += i % 2 == 0 ? scene.region->radius : -scene.region->radius;
    Eigen::Vector2d in_a;
    Eigen::Vector2d in_b;
    if (!Project(a, a.cam_from_world, x, &in_a) || !Project(b, b.cam_from_world, x, &in_b)) return false;
    if (!((in_a - in_b).norm() < kSameCamera)) return false;
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

// Correlation of the patches about a pixel, and the standard deviation of the first.
struct Likeness {
  float correlation = 0;
  float deviation = 0;
};

Likeness ComparePatches(const std::vector<float>& a, const std::vector<float>& b, int width, int x, int y) {
  double sum_a = 0;
  double sum_b = 0;
  double sum_aa = 0;
  double sum_bb = 0;
  double sum_ab = 0;
  for (int v = y - kPatchRadius; v <= y + kPatchRadius; ++v) {
    for (int u = x - kPatchRadius; u <= x + kPatchRadius; ++u) {
      const double in_a = a[static_cast<size_t>(v) * width + u];
      const double in_b = b[static_cast<size_t>(v) * width + u];
      sum_a += in_a;
      sum_b += in_b;
      sum_aa += in_a * in_a;
      sum_bb += in_b * in_b;
      sum_ab += in_a * in_b;
    }
  }
  constexpr double kCount = (2 * kPatchRadius + 1) * (2 * kPatchRadius + 1);
  const double var_a = std::max(0.0, sum_aa - sum_a * sum_a / kCount);
  const double var_b = std::max(0.0, sum_bb - sum_b * sum_b / kCount);
  const double product = std::sqrt(var_a * var_b);
  Likeness likeness;
  likeness.deviation = static_cast<float>(std::sqrt(var_a / kCount));
  if (product > 0) likeness.correlation = static_cast<float>((sum_ab - sum_a * sum_b / kCount) / product);
  return likeness;
}

std::vector<uint32_t> RotatingOnes(const Gaussians& all) {
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

RotatingAlone LookAlone(const Gaussians& rotating, const std::vector<PinholeView>& views, Backend* backend) {
  RotatingAlone alone;
  TrainState state;
  state.gaussians = rotating;
  backend->SetState(state);
  for (const PinholeView& view : views) {
    const std::vector<float> peaks = backend->PeakWeights({view}, SceneBodies::kBoth);
    if (peaks.size() != rotating.size()) return {};
    std::vector<uint8_t> is_visible;
    is_visible.reserve(peaks.size());
    for (const float peak : peaks) is_visible.push_back(peak >= kMinWeight ? 1 : 0);
    alone.is_visible.push_back(std::move(is_visible));
    RenderRequest request;
    request.view = view;
    request.freeze_foreground = true;
    const RenderedView rendered = backend->Render(request);
    std::vector<uint8_t> inside;
    std::vector<uint8_t> opaque;
    inside.reserve(rendered.alpha.size());
    opaque.reserve(rendered.alpha.size());
    for (const float alpha : rendered.alpha) {
      inside.push_back(alpha > kMinWeight ? 1 : 0);
      opaque.push_back(alpha > 0.5F ? 1 : 0);
    }
    alone.opaque.push_back(std::move(opaque));
    alone.covered.push_back(Widened(inside, view.width, view.height, kCoverMargin));
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
      return IsSameCamera(scene, group.front()->view, photo.view);
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
      views_.push_back(ReducedView(photo.view));
      pictures_.push_back(ResizeByArea(photo.image, views_.back().width, views_.back().height));
    }
    camera.end = pictures_.size();
    // Most of a picture stands still: half of the differences are noise alone, or that and drifting light.
    std::vector<float> of_slopes;
    std::vector<float> of_colors;
    const size_t half = count / 2;
    for (size_t i = camera.first; i + half < camera.end; ++i) {
      const std::vector<uint8_t>& a = pictures_[i].pixels;
      const std::vector<uint8_t>& b = pictures_[i + half].pixels;
      for (size_t p = 0; 3 * p + 5 < a.size(); p += kNoiseStride) {
        of_colors.push_back(MostDifferent(&a[3 * p], &b[3 * p]));
        const int slope_a = GreyFromRgb(&a[3 * p + 3]) - GreyFromRgb(&a[3 * p]);
        const int slope_b = GreyFromRgb(&b[3 * p + 3]) - GreyFromRgb(&b[3 * p]);
        of_slopes.push_back(static_cast<float>(std::abs(slope_a - slope_b)) / 2);  // four pixels' noise
      }
    }
    if (of_slopes.empty()) continue;
    camera.noise = std::max(kMinNoise, Quantile(std::move(of_slopes), 0.5) / kNormalMedian);
    camera.tolerance =
        kNoiseFactor * std::max(kMinNoise, Quantile(std::move(of_colors), 0.5) / kNormalMedian);
    cameras_.push_back(camera);
  }
}

std::vector<std::vector<PixelSight>> TurnEvidence::Look(
    const std::vector<std::vector<uint8_t>>& covered) const {
  std::vector<std::vector<PixelSight>> sights(views_.size());
  for (const Camera& camera : cameras_) {
    Image8 background = pictures_[camera.first];
    const int width = background.width;
    const int height = background.height;
    const size_t count = static_cast<size_t>(width) * height;
    std::vector<uint8_t> is_seen(count, 0);
    std::array<std::vector<uint8_t>, 3> channels;
    for (size_t p = 0; p < count; ++p) {
      for (std::vector<uint8_t>& channel : channels) channel.clear();
      for (size_t i = camera.first; i < camera.end; ++i) {
        if (covered[i][p] != 0) continue;
        for (int c = 0; c < 3; ++c) channels[c].push_back(pictures_[i].pixels[3 * p + c]);
      }
      if (channels[0].size() < kMinUncovered) continue;
      is_seen[p] = 1;
      for (int c = 0; c < 3; ++c) background.pixels[3 * p + c] = UpperMedian(channels[c]);
    }
    const std::vector<float> behind = GreyOf(background);
    for (size_t i = camera.first; i < camera.end; ++i) {
      sights[i].assign(count, PixelSight::kNeverFree);
      const std::vector<float> grey = GreyOf(pictures_[i]);
      for (int y = kPatchRadius; y < height - kPatchRadius; ++y) {
        for (int x = kPatchRadius; x < width - kPatchRadius; ++x) {
          const size_t p = static_cast<size_t>(y) * width + x;
          if (is_seen[p] == 0) continue;
          sights[i][p] = PixelSight::kAlike;
          const float slope = (MostDifferent(background.Pixel(x - 1, y), background.Pixel(x + 1, y)) +
                               MostDifferent(background.Pixel(x, y - 1), background.Pixel(x, y + 1))) /
                              2;
          if (MostDifferent(pictures_[i].Pixel(x, y), background.Pixel(x, y)) >
              camera.tolerance + kPoseError * slope) {
            sights[i][p] = PixelSight::kOther;
            continue;
          }
          const Likeness likeness = ComparePatches(behind, grey, width, x, y);
          if (likeness.deviation >= kTextureFactor * camera.noise && likeness.correlation >= kCorrelation) {
            sights[i][p] = PixelSight::kBackground;
          }
        }
      }
    }
  }
  return sights;
}

std::optional<SightShares> MeasureSights(const TurnEvidence& evidence, Backend* backend) {
  SightShares shares;
  if (!evidence.IsAvailable()) return shares;
  const TrainState state = backend->GetState();
  const std::vector<uint32_t> rotating = RotatingOnes(state.gaussians);
  if (rotating.empty()) return std::nullopt;
  const RotatingAlone look = LookAlone(SelectGaussians(state.gaussians, rotating), evidence.views(), backend);
  backend->SetState(state);
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
  const TrainState state = backend->GetState();
  const Gaussians& all = state.gaussians;
  const std::vector<uint32_t> rotating = RotatingOnes(all);
  if (rotating.empty()) return {};
  const Gaussians alone = SelectGaussians(all, rotating);
  const std::vector<PinholeView>& views = evidence.views();
  const RotatingAlone look = LookAlone(alone, views, backend);
  backend->SetState(state);
  if (look.covered.empty()) return {};

  const std::vector<std::vector<PixelSight>> sights = evidence.Look(look.covered);
  const Neighbours near = FindNeighbours(alone.centre, kNeighbours);
  std::vector<SightVotes> votes(rotating.size());
  std::vector<int> seen(rotating.size());
  for (size_t v = 0; v < views.size(); ++v) {
    for (size_t i = 0; i < rotating.size(); ++i) {
      seen[i] = 0;
      const float* x = alone.centre.data() + 3 * i;
      Eigen::Vector2d pixel;
      if (look.is_visible[v][i] == 0 ||
          !Project(views[v], views[v].cam_from_object, Eigen::Vector3d(x[0], x[1], x[2]), &pixel))
        continue;
      if (!(pixel.x() >= 0 && pixel.y() >= 0 && pixel.x() < views[v].width && pixel.y() < views[v].height))
        continue;
      const auto column = static_cast<size_t>(pixel.x());
      const PixelSight sight = sights[v][static_cast<size_t>(pixel.y()) * views[v].width + column];
      seen[i] = sight == PixelSight::kOther ? 1 : sight == PixelSight::kBackground ? -1 : 0;
    }
    for (size_t i = 0; i < rotating.size(); ++i) {
      int sum = seen[i];
      for (int k = 0; k < near.k; ++k) sum += seen[near.index[i * near.k + k]];
      if (sum > 0) ++votes[i].other;
      if (sum < 0) ++votes[i].background;
    }
  }
  std::vector<uint32_t> standing;
  for (size_t i = 0; i < rotating.size(); ++i) {
    if (votes[i].IsStanding()) standing.push_back(rotating[i]);
  }
  return standing;
}

}  // namespace s2gs
