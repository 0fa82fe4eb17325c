#include "s2gs/table/still_witness.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

constexpr int kAboutShade = 2;      // [px]: as far as a rim's edge reaches.
constexpr double kSamePlace = 0.5;  // how far the room's picture may move [px], and poses err

// The pixel of a point that is not at the picture's border.
std::optional<Eigen::Vector2d> InnerPixelOf(const PinholeView& view, const Eigen::Vector3d& x_in_cam) {
  const std::optional<Eigen::Vector2d> pixel = PixelOf(view, x_in_cam);
  const bool is_inner = pixel && pixel->x() >= 1 && pixel->y() >= 1 && pixel->x() < view.width - 1 &&
                        pixel->y() < view.height - 1;
  return is_inner ? pixel : std::nullopt;
}

// Whether a picture shows about a pixel what another does in less light: weaker by one factor in all channels
// and in the neighbours, too, as shadows are but at their borders. \param most  that values may differ by.
bool IsInLessLight(const Image8& image, const Image8& lit, int x, int y, float most) {
  const auto sum_of = [](const uint8_t* rgb) { return static_cast<float>(rgb[0]) + rgb[1] + rgb[2]; };
  const float sum = sum_of(lit.Pixel(x, y));
  const float gain = sum > 0 ? sum_of(image.Pixel(x, y)) / sum : 1;
  if (!(gain < 1)) return false;
  for (int v = std::max(0, y - kAboutShade); v <= std::min(image.height - 1, y + kAboutShade); ++v) {
    for (int u = std::max(0, x - kAboutShade); u <= std::min(image.width - 1, x + kAboutShade); ++u) {
      for (int c = 0; c < 3; ++c) {
        if (std::abs(image.Pixel(u, v)[c] - gain * lit.Pixel(u, v)[c]) > most) return false;
      }
    }
  }
  return true;
}

}  // namespace

StillWitness::StillWitness(const StationPhotos& station, const RotatingRegion& table)
    : station_(station),
      noise_(MeasurePictureNoise(station.images.data(), station.images.size())),
      least_texture_(LeastTexture(noise_)) {
  tables_.reserve(station.views.size());
  for (const PinholeView& view : station.views) tables_.emplace_back(table, view);
}

std::optional<StillSight> StillWitness::Look(size_t photo, const Eigen::Vector3d& x_in_object) const {
  const PinholeView& view = station_.views[photo];
  const Eigen::Vector3d in_camera = view.cam_from_object * x_in_object;
  const std::optional<Eigen::Vector2d> pixel = InnerPixelOf(view, in_camera);
  if (!pixel || !(MovedBy(view, in_camera, *pixel) < kSamePlace)) return std::nullopt;
  const auto x = static_cast<int>(pixel->x());
  const auto y = static_cast<int>(pixel->y());
  const std::optional<RegionHit> hit = tables_[photo].At(x, y);
  if (hit && hit->depth < in_camera.z()) return std::nullopt;
  const float most = noise_.tolerance + static_cast<float>(kSamePlace) * SlopeAt(station_.still, x, y);
  const uint8_t* rgb = station_.images[photo].Pixel(x, y);
  StillSight sight;
  sight.pixel = *pixel;
  sight.depth = in_camera.z();
  const uint8_t* still = station_.still.Pixel(x, y);
  sight.is_same = !(MostDifferentChannel(rgb, still) > most);
  sight.is_shade = !sight.is_same && IsInLessLight(station_.images[photo], station_.still, x, y, most);
  sight.has_texture = HasTexture(x, y);
  sight.color = Eigen::Vector3d(rgb[0], rgb[1], rgb[2]);
  sight.tolerance = noise_.tolerance;
  return sight;
}

bool StillWitness::HasTexture(int x, int y) const {
  const Image8& still = station_.still;
  return x >= kTextureRadius && y >= kTextureRadius && x + kTextureRadius < still.width &&
         y + kTextureRadius < still.height && TextureAt(still, x, y) >= least_texture_;
}

// A camera that was touched sees the room elsewhere than the first view, of which the still picture is [px].
double StillWitness::MovedBy(const PinholeView& view, const Eigen::Vector3d& in_camera,
                             const Eigen::Vector2d& pixel) const {
  const PinholeView& first = station_.views.front();
  const std::optional<Eigen::Vector2d> there =
      InnerPixelOf(first, first.cam_from_world * (view.cam_from_world.Inverse() * in_camera));
  return there ? (*there - pixel).norm() : kSamePlace;
}

StillVotes AskWitnesses(
    const std::vector<StillWitness>& witnesses, const Eigen::Vector3d& x_in_object,
    const std::function<bool(size_t, size_t, const Eigen::Vector2d&, double)>& is_hidden) {
  StillVotes votes;
  std::vector<StillSight> same;
  std::array<std::vector<double>, 3> tints;
  for (size_t w = 0; w < witnesses.size(); ++w) {
    for (size_t i = 0; i < witnesses[w].NumPhotos(); ++i) {
      const std::optional<StillSight> sight = witnesses[w].Look(i, x_in_object);
      if (!sight || is_hidden(w, i, sight->pixel, sight->depth)) continue;
      if (!sight->is_same) {
        ++votes.changes;
        votes.shades += sight->is_shade ? 1 : 0;
        continue;
      }
      ++votes.same;
      if (!(sight->color.sum() > 0)) continue;
      same.push_back(*sight);
      for (int k = 0; k < 3; ++k) tints[k].push_back(sight->color[k] / sight->color.sum());
    }
  }
  if (same.empty()) return votes;
  Eigen::Vector3d tint;
  for (int k = 0; k < 3; ++k) tint[k] = UpperMedian(std::move(tints[k]));
  for (const StillSight& sight : same) {
    const bool is_tinted = (sight.color - sight.color.sum() * tint).cwiseAbs().maxCoeff() > sight.tolerance;
    votes.tinted += is_tinted ? 1 : 0;
    votes.told += is_tinted || sight.has_texture ? 1 : 0;
  }
  return votes;
}

}  // namespace s2gs
