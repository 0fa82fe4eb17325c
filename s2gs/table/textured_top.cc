#include "s2gs/table/textured_top.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <utility>

#include "s2gs/image/bilinear.h"
#include "s2gs/image/photos.h"
#include "s2gs/image/picture_noise.h"
#include "s2gs/table/opaque_region.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/parallel_for.h"

namespace s2gs {
namespace {

constexpr int kMaxPhotos = 48;  // of all stations, evenly: pairs of photos are compared
constexpr int kRadius = 3;      // of a patch [places]
constexpr int kPatch = (2 * kRadius + 1) * (2 * kRadius + 1);
// Patches of 49 points, some 16 of which are independent, are so alike by chance in one pair of 500.
constexpr float kAlike = 0.7F;
// Photos beside the one that they agree with: chance in one place of 20,000.
constexpr int kLeastAlike = 3;
constexpr int kRowsAtOnce = 16;  // of places, whose patches reach six rows more
constexpr int kBorder = 2;       // [px], of blur, and of patches that reach over a border

constexpr int kSectors = 12;        // of the top's outer part,
constexpr int kRings = 2;           // and rings,
constexpr double kInnermost = 0.5;  // from this on [radii]
// A cell has a thousand places, one of which agrees by chance once in twenty cells; three do not.
constexpr int kPlacesOfCell = 3;

// Of a place in a photo; 0: the photo does not tell.
constexpr uint8_t kShown = 255;
constexpr uint8_t kHidden = 1;

using Patch = std::array<float, kPatch>;

// Calls work(first, last) for all rows, some of them in a row, from several threads.
template <typename Work>
void ForRows(int count, const Work& work) {
  ParallelFor((count + kRowsAtOnce - 1) / kRowsAtOnce, 0, [&](int64_t block) {
    const int first = static_cast<int>(block) * kRowsAtOnce;
    work(first, std::min(first + kRowsAtOnce, count) - 1);
  });
}

float Product(const float* a, const float* b) {
  float sum = 0;
  for (int k = 0; k < kPatch; ++k) sum += a[k] * b[k];
  return sum;
}

// Of mean 0 and length 1. \return  false where there is no texture.
bool Normalise(float least_texture, float* patch) {
  float mean = 0;
  for (int k = 0; k < kPatch; ++k) mean += patch[k] / kPatch;
  float squares = 0;
  for (int k = 0; k < kPatch; ++k) {
    patch[k] -= mean;
    squares += patch[k] * patch[k];
  }
  if (!(squares > kPatch * least_texture * least_texture)) return false;
  for (int k = 0; k < kPatch; ++k) patch[k] /= std::sqrt(squares);
  return true;
}

}  // namespace

Eigen::Vector3d TexturedTop::PlaceAt(double column, double row) const {
  const double half = 0.5 * (side_ - 1);
  return table_.axis.point + table_.high * table_.axis.direction +
         spacing_ * ((column - half) * along_x_ + (row - half) * along_y_);
}

// A photo as the places see it.
struct TexturedTop::Witness {
  Image8 grey;
  const PinholeView* view;

  bool Sample(const Eigen::Vector3d& x_in_object, float* value) const {
    const std::optional<Eigen::Vector2d> pixel = PixelOf(*view, view->cam_from_object * x_in_object);
    if (!pixel) return false;
    const double u = pixel->x() - 0.5;
    const double v = pixel->y() - 0.5;
    if (!(u >= 0 && v >= 0 && u < grey.width - 1 && v < grey.height - 1)) return false;
    *value = Bilinear<1>(grey, *pixel)[0];
    return true;
  }
};

// What a photo shows at the places of some rows and of those that their patches reach: each place is looked
// up once, and is part of 49 patches.
class TexturedTop::SampledRows {
 public:
  SampledRows(const TexturedTop& top, const Witness& witness, int first, int last)
      : side_(top.side_), first_(std::max(0, first - kRadius)) {
    const int end = std::min(side_, last + kRadius + 1);
    values_.assign(static_cast<size_t>(end - first_) * side_, std::numeric_limits<float>::quiet_NaN());
    const Eigen::Vector3d middle = top.table_.axis.point + top.table_.high * top.table_.axis.direction;
    // To the corners of the patches that touch the rim.
    const double reach = top.table_.radius + kRadius * top.spacing_;
    for (int row = first_; row < end; ++row) {
      for (int column = 0; column < side_; ++column) {
        const Eigen::Vector3d place = top.PlaceAt(column, row);
        if ((place - middle).squaredNorm() <= reach * reach)
          witness.Sample(place, &values_[static_cast<size_t>(row - first_) * side_ + column]);
      }
    }
  }

  // \return  false where the photo does not show the patch, or no texture.
  bool ReadPatch(int column, int row, float least_texture, float* patch) const {
    for (int v = -kRadius, k = 0; v <= kRadius; ++v) {
      const float* const values = &values_[static_cast<size_t>(row + v - first_) * side_ + column];
      for (int u = -kRadius; u <= kRadius; ++u, ++k) {
        if (std::isnan(values[u])) return false;
        patch[k] = values[u];
      }
    }
    return Normalise(least_texture, patch);
  }

 private:
  const int side_;
  const int first_;            // row
  std::vector<float> values_;  // row by row; not a number where the photo does not show the place
};

std::optional<TexturedTop> TexturedTop::Learn(const std::vector<StationPhotos>& stations,
                                              const RotatingRegion& table) {
  TexturedTop top(table);
  top.along_x_ = table.axis.direction.unitOrthogonal();
  top.along_y_ = table.axis.direction.cross(top.along_x_);
  size_t total = 0;
  for (const StationPhotos& station : stations) total += station.views.size();
  std::vector<Witness> witnesses;
  float least_texture = 0;
  size_t index = 0;
  const Eigen::Vector3d middle = table.axis.point + table.high * table.axis.direction;
  for (const StationPhotos& station : stations) {
    const float texture = LeastTexture(MeasurePictureNoise(station.images.data(), station.images.size()));
    for (size_t i = 0; i < station.views.size(); ++i, ++index) {
      const bool is_chosen =
          total <= kMaxPhotos || index * kMaxPhotos / total != (index + 1) * kMaxPhotos / total;
      const PinholeView& view = station.views[i];
      const Eigen::Vector3d camera = view.cam_from_world.Inverse().translation;
      if (!is_chosen || !((camera - middle).dot(table.axis.direction) > 0)) continue;
      least_texture = std::max(least_texture, texture);
      witnesses.push_back({GreyImage(station.images[i]), &view});
      const double pixel = (view.cam_from_object * middle).z() / view.fx;
      top.spacing_ = top.spacing_ > 0 ? std::min(top.spacing_, pixel) : pixel;
    }
  }
  if (witnesses.size() <= kLeastAlike || !(top.spacing_ > 0)) return std::nullopt;
  top.side_ = 2 * static_cast<int>(table.radius / top.spacing_) + 1;
  top.least_texture_ = least_texture;
  top.patches_.resize(static_cast<size_t>(top.side_) * top.side_);
  ForRows(top.side_, [&](int first, int last) { top.LearnRows(witnesses, first, last); });
  const bool is_known = std::any_of(top.patches_.begin(), top.patches_.end(),
                                    [](const std::vector<float>& patch) { return !patch.empty(); });
  return is_known ? std::make_optional(std::move(top)) : std::nullopt;
}

void TexturedTop::LearnRows(const std::vector<Witness>& witnesses, int first, int last) {
  std::vector<SampledRows> photos;
  photos.reserve(witnesses.size());
  for (const Witness& witness : witnesses) photos.emplace_back(*this, witness, first, last);
  std::vector<Patch> patches(witnesses.size());
  for (int row = first; row <= last; ++row) {
    for (int column = 0; column < side_; ++column) {
      if (!HoldsPatch(column, row)) continue;
      size_t count = 0;
      for (const SampledRows& photo : photos) {
        if (photo.ReadPatch(column, row, least_texture_, patches[count].data())) ++count;
      }
      int most = 0;
      size_t best = 0;
      for (size_t i = 0; i < count; ++i) {
        int alike = 0;
        for (size_t j = 0; j < count; ++j)
          alike += j != i && Product(patches[i].data(), patches[j].data()) > kAlike ? 1 : 0;
        if (alike > most) {
          most = alike;
          best = i;
        }
      }
      if (most < kLeastAlike) continue;
      patches_[static_cast<size_t>(row) * side_ + column].assign(patches[best].begin(), patches[best].end());
    }
  }
}

bool TexturedTop::HoldsPatch(int column, int row) const {
  const Eigen::Vector3d middle = table_.axis.point + table_.high * table_.axis.direction;
  return std::min(column, row) >= kRadius && std::max(column, row) + kRadius < side_ &&
         (PlaceAt(column, row) - middle).norm() <= table_.radius - kRadius * spacing_;
}

double TexturedTop::AgreedShare() const {
  std::array<int, kSectors * kRings> places{};
  const double half = 0.5 * (side_ - 1);
  for (int row = 0; row < side_; ++row) {
    for (int column = 0; column < side_; ++column) {
      if (patches_[static_cast<size_t>(row) * side_ + column].empty()) continue;
      const double radius = spacing_ * std::hypot(column - half, row - half) / table_.radius;
      const int ring = static_cast<int>(std::floor((radius - kInnermost) / (1 - kInnermost) * kRings));
      if (ring < 0 || ring >= kRings) continue;
      const double turn = (std::atan2(row - half, column - half) + kPi) / (2 * kPi);
      const int sector = std::min(kSectors - 1, static_cast<int>(turn * kSectors));
      ++places[static_cast<size_t>(ring) * kSectors + sector];
    }
  }
  const auto agreed =
      std::count_if(places.begin(), places.end(), [](int count) { return count >= kPlacesOfCell; });
  return static_cast<double>(agreed) / static_cast<double>(places.size());
}

std::vector<TopSight> TexturedTop::Sights(const Image8& photo, const PinholeView& view) const {
  const Witness witness{GreyImage(photo), &view};
  std::vector<uint8_t> is_seen(patches_.size(), 0);
  ForRows(side_, [&](int first, int last) {
    const SampledRows sampled(*this, witness, first, last);
    Patch patch;
    for (int row = first; row <= last; ++row) {
      for (int column = 0; column < side_; ++column) {
        const size_t i = static_cast<size_t>(row) * side_ + column;
        if (patches_[i].empty() || !sampled.ReadPatch(column, row, least_texture_, patch.data())) continue;
        is_seen[i] = Product(patch.data(), patches_[i].data()) > kAlike ? kShown : kHidden;
      }
    }
  });
  RotatingRegion top = table_;
  top.low = top.high;
  const RegionView hits(top, view);
  const Rigid3 object_from_cam = view.cam_from_object.Inverse();
  const double half = 0.5 * (side_ - 1);
  Image8 shows{view.width, view.height, 1, {}};
  shows.pixels.assign(static_cast<size_t>(view.width) * view.height, 0);
  for (int y = 0; y < view.height; ++y) {
    for (int x = 0; x < view.width; ++x) {
      const std::optional<RegionHit> hit = hits.At(x, y);
      if (!hit) continue;
      const Eigen::Vector3d ray((x + 0.5 - view.cx) / view.fx, (y + 0.5 - view.cy) / view.fy, 1);
      const Eigen::Vector3d from_axis = object_from_cam * (hit->depth * ray) - table_.axis.point;
      const auto column = static_cast<int>(std::lround(from_axis.dot(along_x_) / spacing_ + half));
      const auto row = static_cast<int>(std::lround(from_axis.dot(along_y_) / spacing_ + half));
      if (column < 0 || row < 0 || column >= side_ || row >= side_) continue;
      *shows.Pixel(x, y) = is_seen[static_cast<size_t>(row) * side_ + column];
    }
  }
  std::vector<TopSight> sights(shows.pixels.size(), TopSight::kElsewhere);
  for (int y = 0; y < view.height; ++y) {
    for (int x = 0; x < view.width; ++x) {
      TopSight& sight = sights[static_cast<size_t>(y) * view.width + x];
      if (*shows.Pixel(x, y) == kHidden) sight = TopSight::kOther;
      if (*shows.Pixel(x, y) != kShown) continue;
      sight = TopSight::kLit;
      for (int v = -kBorder; v <= kBorder; ++v) {
        for (int u = -kBorder; u <= kBorder; ++u) {
          const bool is_within = x + u >= 0 && y + v >= 0 && x + u < view.width && y + v < view.height;
          if (!is_within || *shows.Pixel(x + u, y + v) == kHidden) sight = TopSight::kElsewhere;
        }
      }
    }
  }
  return sights;
}

Image8 TexturedTop::Look(const Image8& photo, const PinholeView& view) const {
  const std::vector<TopSight> sights = Sights(photo, view);
  Image8 marks{view.width, view.height, 1, std::vector<uint8_t>(sights.size(), 0)};
  for (size_t i = 0; i < sights.size(); ++i) {
    if (sights[i] == TopSight::kLit) marks.pixels[i] = 255;
  }
  return marks;
}

}  // namespace s2gs
