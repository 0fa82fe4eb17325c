#include "s2gs/table/plain_top.h"

#include <Eigen/Dense>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <numeric>
#include <utility>

#include "s2gs/image/picture_noise.h"
#include "s2gs/image/srgb.h"
#include "s2gs/table/opaque_region.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/solvers/eigen_solvers.h"

namespace s2gs {
namespace {

constexpr double kRingInner = 0.8;  // of the radius: next to the rim hardly anything stands.
constexpr double kRingOuter = 0.97;
constexpr int kLeastPixels = 100;    // of a ring, for its colour
constexpr int kRounds = 6;           // of robust fits
constexpr double kDeviations = 3;    // of noise and of the fit: another colour.
constexpr double kFirstLimit = 0.1;  // of the logarithm, about a ring's most frequent colour
// Of the same about a ring's fitted colour: more is not one smooth colour. It was .006 to .011 where it is,
// .05 to .08 where shadows were taken for it.
constexpr double kMaxDeviation = 0.03;
constexpr double kLitShare = 0.3;  // of a ring, at least, in any photo
// Cells of a ring that turns with the table, of about a patch, by whose texture patterns are told.
constexpr int kRingRows = 5;
constexpr int kRowsOfABorder = 2;  // of a round thing's shadow, which looks the same all around
constexpr int kRingColumns = 120;
constexpr int kLeastPhotos = 3;  // that see a cell
// Of the cells: speckles have .3 to .4, plain tops 0, borders of shadows that stand still .04.
constexpr double kPattern = 0.1;
constexpr double kDarkest = 0.2;  // of the lit colour, in a shadow
// A normal law's standard deviation over a quarter's largest absolute value.
constexpr double kSigmaOfQuartile = 1 / 0.3186;
constexpr double kLeastDeviation = 0.004;  // of the logarithm: a grey level of 255
constexpr int kPatchRadius = 2;            // [px]: larger patches do not fit between the parts of a thing.
constexpr int kLineRadius = 1;  // [px], of patches that tell a border, which no larger one fits beside
constexpr int kBorder = 2;      // [px], of blur and of poses that err

using Color = Eigen::RowVector3d;
using Terms = Eigen::Matrix<double, 1, 6>;

// \param level  on the top, in radii.
Terms TermsOf(const Eigen::Vector2d& level) {
  const double x = level.x();
  const double y = level.y();
  return Terms{{1, x, y, x * x, x * y, y * y}};
}

// Of the mean colour about a pixel: noise and grain are left out.
Color LogColor(const Image8& image, int x, int y, int radius) {
  Color sum = Color::Zero();
  for (int v = -radius; v <= radius; ++v) {
    for (int u = -radius; u <= radius; ++u) {
      const uint8_t* pixel = image.Pixel(x + u, y + v);
      sum += Color(pixel[0], pixel[1], pixel[2]);
    }
  }
  const int side = 2 * radius + 1;
  return (sum / (side * side)).cwiseMax(1).array().log();
}

bool IsOnRing(const Eigen::Vector2d& level) { return level.norm() > kRingInner && level.norm() < kRingOuter; }

// The middle of the shortest interval that holds kLitShare of the values: shadows scatter, light does not. 0
// when there are none.
double MiddleOfDensest(std::vector<double> values) {
  if (values.empty()) return 0;
  std::sort(values.begin(), values.end());
  const auto held = static_cast<size_t>(kLitShare * static_cast<double>(values.size()));
  size_t first = 0;
  for (size_t i = 0; i + held < values.size(); ++i) {
    if (values[i + held] - values[i] < values[first + held] - values[first]) first = i;
  }
  return (values[first] + values[first + held]) / 2;
}

// Half of a ring may be in shadows, but not three quarters.
double DeviationOfLit(std::vector<double> absolute_errors) {
  return std::max(kLeastDeviation, kSigmaOfQuartile * Quantile(std::move(absolute_errors), 0.25));
}

}  // namespace

PlainTop::PlainTop(const RotatingRegion& table) : table_(table), top_(table) {
  top_.low = top_.high;
  along_x_ = table.axis.direction.unitOrthogonal();
  along_y_ = table.axis.direction.cross(along_x_);
}

Eigen::Vector2d PlainTop::LevelOf(const Eigen::Vector3d& x) const {
  const Eigen::Vector3d from_axis = x - table_.axis.point;
  return Eigen::Vector2d(from_axis.dot(along_x_), from_axis.dot(along_y_)) / table_.radius;
}

std::vector<PlainTop::TopPixel> PlainTop::PixelsOf(const PinholeView& view) const {
  const RegionView seen(top_, view);
  const Rigid3 world_from_cam = view.cam_from_world.Inverse();
  std::vector<TopPixel> pixels;
  for (int y = kTextureRadius; y + kTextureRadius < view.height; ++y) {
    for (int x = kTextureRadius; x + kTextureRadius < view.width; ++x) {
      const std::optional<RegionHit> hit = seen.At(x, y);
      const bool is_inner = hit && seen.At(x - kTextureRadius, y) && seen.At(x + kTextureRadius, y) &&
                            seen.At(x, y - kTextureRadius) && seen.At(x, y + kTextureRadius);
      if (!is_inner) continue;
      const Eigen::Vector3d ray((x + 0.5 - view.cx) / view.fx, (y + 0.5 - view.cy) / view.fy, 1);
      pixels.push_back({x, y, world_from_cam * (hit->depth * ray)});
    }
  }
  return pixels;
}

// What is texture beside a plain top's own grain, which sharpening lifts over noise: borders of shadows and
// what stands there are on less than three quarters of the ring.
float PlainTop::TextureOverGrain(const StationPhotos& station) const {
  std::vector<float> textures;
  for (size_t i = 0; i < station.images.size(); ++i) {
    for (const TopPixel& pixel : PixelsOf(station.views[i])) {
      if (IsOnRing(LevelOf(pixel.x_in_world)))
        textures.push_back(TextureAt(station.images[i], pixel.x, pixel.y, kPatchRadius));
    }
  }
  if (textures.empty()) return 0;
  return kTextureFactor * Quantile(std::move(textures), 0.25F);
}

std::optional<PlainTop::TopColor> PlainTop::LearnColor(const StationPhotos& station) const {
  const Eigen::Vector3d camera = station.views.front().cam_from_world.Inverse().translation;
  if (!((camera - table_.axis.point).dot(table_.axis.direction) > table_.high)) return std::nullopt;
  TopColor color;
  color.station = station.number;
  color.least_texture =
      std::max(LeastTexture(MeasurePictureNoise(station.images.data(), station.images.size())),
               TextureOverGrain(station));
  std::vector<Terms> terms;
  std::vector<Color> colors;
  std::vector<uint8_t> is_ring;
  for (const TopPixel& pixel : PixelsOf(station.views.front())) {
    if (TextureAt(station.still, pixel.x, pixel.y, kPatchRadius) >= color.least_texture) continue;
    const Eigen::Vector2d level = LevelOf(pixel.x_in_world);
    terms.push_back(TermsOf(level));
    colors.push_back(LogColor(station.still, pixel.x, pixel.y, kPatchRadius));
    is_ring.push_back(IsOnRing(level) ? 1 : 0);
  }
  if (std::count(is_ring.begin(), is_ring.end(), 1) < kLeastPixels) return std::nullopt;

  // What is darker than most of the ring is a shadow, which stands still where its thing is round. A ring by
  // itself does not tell how light bends within it: a slope first, from there inwards.
  std::array<std::vector<double>, 3> on_ring;
  for (size_t i = 0; i < colors.size(); ++i) {
    if (is_ring[i] == 0) continue;
    for (int k = 0; k < 3; ++k) on_ring[k].push_back(colors[i][k]);
  }
  for (int k = 0; k < 3; ++k) color.terms(0, k) = MiddleOfDensest(std::move(on_ring[k]));
  double limit = kFirstLimit;
  for (int round = 0; round < kRounds; ++round) {
    const int count = round < kRounds / 2 ? 3 : 6;
    Eigen::MatrixXd squares = Eigen::MatrixXd::Zero(count, count);
    Eigen::MatrixXd products = Eigen::MatrixXd::Zero(count, 3);
    for (size_t i = 0; i < terms.size(); ++i) {
      if (count == 3 && is_ring[i] == 0) continue;
      const Color error = colors[i] - terms[i] * color.terms;
      if (error.cwiseAbs().maxCoeff() > limit) continue;
      // What a shadow or a thing covers pulls little (Cauchy's weights).
      const double weight = 1 / (1 + error.squaredNorm() / (limit * limit));
      const auto term = terms[i].head(count);
      squares += weight * term.transpose() * term;
      products += weight * term.transpose() * colors[i];
    }
    const Eigen::LDLT<Eigen::MatrixXd> solver(squares);
    if (solver.info() != Eigen::Success || !(solver.rcond() > 1e-9)) return std::nullopt;
    color.terms.topRows(count) = solver.solve(products);
    std::vector<double> errors;
    for (size_t i = 0; i < terms.size(); ++i) {
      if (is_ring[i] != 0) errors.push_back((colors[i] - terms[i] * color.terms).cwiseAbs().maxCoeff());
    }
    limit = std::min(kFirstLimit, kDeviations * DeviationOfLit(std::move(errors)));
  }

  std::vector<double> errors;
  for (size_t i = 0; i < station.images.size(); ++i) {
    const std::vector<TopPixel> pixels = PixelsOf(station.views[i]);
    const std::vector<Color> of_photo = ErrorsOf(color, station.images[i], pixels, kPatchRadius);
    for (size_t k = 0; k < pixels.size(); ++k) {
      if (IsOnRing(LevelOf(pixels[k].x_in_world))) errors.push_back(of_photo[k].cwiseAbs().mean());
    }
  }
  color.deviation = DeviationOfLit(std::move(errors));
  if (!(color.deviation < kMaxDeviation) || PatternOn(color, station) > kPattern) return std::nullopt;
  color.shadow = LearnShadow(color, station);
  return color;
}

// Share of the ring's cells that have texture in most photos, as spots have that go round with the table.
// What hides a pattern is a thing, though the gaps in it have the thing's colour.
double PlainTop::PatternOn(const TopColor& color, const StationPhotos& station) const {
  struct Cell {
    int num_seen = 0;
    int num_textured = 0;
  };
  std::vector<Cell> cells(size_t{kRingRows} * kRingColumns);
  for (size_t i = 0; i < station.images.size(); ++i) {
    const Rigid3 object_from_world =
        station.views[i].cam_from_object.Inverse() * station.views[i].cam_from_world;
    std::vector<Cell> of_photo(cells.size());
    for (const TopPixel& pixel : PixelsOf(station.views[i])) {
      const Eigen::Vector2d level = LevelOf(object_from_world * pixel.x_in_world);
      if (!IsOnRing(level)) continue;
      const auto row =
          static_cast<size_t>((level.norm() - kRingInner) / (kRingOuter - kRingInner) * kRingRows);
      const auto column =
          static_cast<size_t>((std::atan2(level.y(), level.x()) / (2 * kPi) + 0.5) * kRingColumns);
      Cell& cell = of_photo[std::min<size_t>(row, kRingRows - 1) * kRingColumns + column % kRingColumns];
      ++cell.num_seen;
      cell.num_textured +=
          TextureAt(station.images[i], pixel.x, pixel.y, kPatchRadius) >= color.least_texture ? 1 : 0;
    }
    for (size_t k = 0; k < cells.size(); ++k) {
      if (of_photo[k].num_seen == 0) continue;
      ++cells[k].num_seen;
      cells[k].num_textured += 2 * of_photo[k].num_textured > of_photo[k].num_seen ? 1 : 0;
    }
  }
  int num_seen = 0;
  std::array<int, kRingRows> num_textured{};
  for (size_t k = 0; k < cells.size(); ++k) {
    if (cells[k].num_seen < kLeastPhotos) continue;
    ++num_seen;
    num_textured[k / kRingColumns] += 2 * cells[k].num_textured > cells[k].num_seen ? 1 : 0;
  }
  std::sort(num_textured.begin(), num_textured.end());
  const int num_told = std::accumulate(num_textured.begin(), num_textured.end() - kRowsOfABorder, 0);
  return num_seen > 0 ? static_cast<double>(num_told) / num_seen : 0;
}

// A shadow that falls next to the rim has only the sky's light there. Nothing where none does, or shadows
// have no colour of their own.
std::optional<PlainTop::ShadowColor> PlainTop::LearnShadow(const TopColor& color,
                                                           const StationPhotos& station) const {
  std::vector<Color> shades;
  std::vector<double> levels;
  for (size_t i = 0; i < station.images.size(); ++i) {
    const std::vector<TopPixel> pixels = PixelsOf(station.views[i]);
    const std::vector<Color> errors = ErrorsOf(color, station.images[i], pixels, kPatchRadius);
    for (size_t k = 0; k < pixels.size(); ++k) {
      const double level = errors[k].mean();
      const bool is_dark = level < -2 * kDeviations * color.deviation && level > std::log(kDarkest);
      if (!is_dark || !IsOnRing(LevelOf(pixels[k].x_in_world)) ||
          (errors[k].array() - level).abs().maxCoeff() > kFirstLimit ||
          TextureAt(station.images[i], pixels[k].x, pixels[k].y, kPatchRadius) >= color.least_texture)
        continue;
      shades.push_back(errors[k]);
      levels.push_back(level);
    }
  }
  if (levels.size() < kLeastPixels) return std::nullopt;
  const double middle = MiddleOfDensest(std::move(levels));
  std::array<std::vector<double>, 3> tints;
  for (const Color& shade : shades) {
    if (std::abs(shade.mean() - middle) > kFirstLimit) continue;
    for (int k = 0; k < 3; ++k) tints[k].push_back(shade[k] - shade.mean());
  }
  ShadowColor shadow;
  std::vector<double> errors;
  for (int k = 0; k < 3; ++k) {
    const double tint = UpperMedian(tints[k]);
    shadow.umbra[k] = middle + tint;
    for (const double other : tints[k]) errors.push_back(std::abs(other - tint));
  }
  shadow.deviation = std::max(color.deviation, kSigmaOfMad * UpperMedian(std::move(errors)));
  if (!(shadow.deviation < kMaxDeviation)) return std::nullopt;
  // By the tone curve of sRGB, as nothing better is known of the camera's tone curve.
  const double lit = std::exp(color.terms.row(0).mean()) / 255;
  const double sky = LightFromSrgb(lit * std::exp(middle)) / LightFromSrgb(lit);
  shadow.darkest_lit = std::log(SrgbFromLight(LightFromSrgb(lit) * (1 - sky)) / lit);
  return shadow;
}

// Of the logarithms, less a photo's own exposure and white balance.
std::vector<Eigen::RowVector3d> PlainTop::ErrorsOf(const TopColor& color, const Image8& photo,
                                                   const std::vector<TopPixel>& pixels, int radius) const {
  std::vector<Color> errors;
  errors.reserve(pixels.size());
  std::array<std::vector<double>, 3> on_ring;
  for (const TopPixel& pixel : pixels) {
    const Eigen::Vector2d level = LevelOf(pixel.x_in_world);
    errors.emplace_back(LogColor(photo, pixel.x, pixel.y, radius) - TermsOf(level) * color.terms);
    if (!IsOnRing(level)) continue;
    for (int k = 0; k < 3; ++k) on_ring[k].push_back(errors.back()[k]);
  }
  Color gain;
  for (int k = 0; k < 3; ++k) gain[k] = MiddleOfDensest(std::move(on_ring[k]));
  for (Color& error : errors) error -= gain;
  return errors;
}

std::optional<PlainTop> PlainTop::Learn(const std::vector<StationPhotos>& stations,
                                        const RotatingRegion& table) {
  PlainTop top(table);
  std::vector<std::optional<TopColor>> colors(stations.size());
  ParallelFor(static_cast<int64_t>(stations.size()), 0, [&](int64_t i) {
    colors[static_cast<size_t>(i)] = top.LearnColor(stations[static_cast<size_t>(i)]);
  });
  for (const std::optional<TopColor>& color : colors) {
    if (color) top.colors_.push_back(*color);
  }
  if (top.colors_.empty()) return std::nullopt;
  return top;
}

std::vector<TopSight> PlainTop::Look(const Image8& photo, const PinholeView& view, int station) const {
  std::vector<TopSight> sights(static_cast<size_t>(view.width) * view.height, TopSight::kElsewhere);
  const auto color = std::find_if(colors_.begin(), colors_.end(),
                                  [&](const TopColor& other) { return other.station == station; });
  if (color == colors_.end()) return sights;
  const std::vector<TopPixel> pixels = PixelsOf(view);
  std::vector<uint8_t> is_near_top(sights.size(), 0);
  const std::vector<Color> of_line = ErrorsOf(*color, photo, pixels, kLineRadius);
  for (size_t i = 0; i < pixels.size(); ++i) {
    if (!IsOnShadeLine(*color, of_line[i])) continue;
    for (int y = pixels[i].y - kBorder; y <= pixels[i].y + kBorder; ++y)
      std::fill_n(&is_near_top[static_cast<size_t>(y) * view.width + pixels[i].x - kBorder], 2 * kBorder + 1,
                  1);
  }
  const std::vector<Color> errors = ErrorsOf(*color, photo, pixels, kPatchRadius);
  for (size_t i = 0; i < pixels.size(); ++i) {
    const size_t p = static_cast<size_t>(pixels[i].y) * view.width + pixels[i].x;
    const bool is_plain = TextureAt(photo, pixels[i].x, pixels[i].y, kPatchRadius) < color->least_texture;
    if (is_plain) {
      sights[p] = SightOf(*color, errors[i]);
    } else {
      sights[p] = is_near_top[p] != 0 ? TopSight::kBorder : TopSight::kOther;
    }
  }
  return sights;
}

// Of a plain patch.
TopSight PlainTop::SightOf(const TopColor& color, const Color& error) {
  const double limit = kDeviations * color.deviation;
  if (error.cwiseAbs().maxCoeff() < limit) return TopSight::kLit;
  if (!IsOnShadeLine(color, error)) return TopSight::kOther;
  if (!color.shadow) return TopSight::kElsewhere;
  // Between both is the soft border of a shadow, which is no plain patch.
  const double level = error.mean();
  const double umbra = color.shadow->umbra.mean();
  if (level < umbra + kDeviations * color.shadow->deviation / std::exp(umbra)) return TopSight::kShadow;
  return level > color.shadow->darkest_lit ? TopSight::kElsewhere : TopSight::kOther;
}

// From lit to the umbra, and on from there to black; noise grows as the light goes.
bool PlainTop::IsOnShadeLine(const TopColor& color, const Color& error) {
  const double level = error.mean();
  const double limit = kDeviations * (color.shadow ? color.shadow->deviation : color.deviation);
  if (!(level < limit && level > std::log(kDarkest))) return false;
  Color tint = Color::Zero();
  if (color.shadow) {
    const double umbra = color.shadow->umbra.mean();
    tint = (color.shadow->umbra.array() - umbra) * std::clamp(level / umbra, 0.0, 1.0);
  }
  return (error.array() - level - tint.array()).abs().maxCoeff() < limit / std::exp(std::min(level, 0.0));
}

}  // namespace s2gs
