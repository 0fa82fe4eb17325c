#include "s2gs/plain_top.h"

#include <Eigen/Dense>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstddef>

#include "s2gs/image/picture_noise.h"
#include "s2gs/kernel/foreground.h"
#include "s2gs/opaque_region.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/statistics.h"

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
constexpr double kDarkest = 0.2;   // of the lit colour, in a shadow
// A normal law's standard deviation over a quarter's largest absolute value.
constexpr double kSigmaOfQuartile = 1 / 0.3186;
constexpr double kLeastDeviation = 0.004;  // of the logarithm: a grey level of 255
// A thing's Gaussians look lit in less than .01 of the photos; of a layer's half do, and in the others a
// shadow's border or a thing behind it is seen. So one photo that sees the top is worth ln(.5 / .01), one
// that does not ln(.99 / .5), a fifth of it; a single one may be chance.
constexpr int kLeastLit = 2;
constexpr int kOtherPerLit = 4;
constexpr double kBehind = 3;  // [px], of a surface that hides what lies further behind it

using Color = Eigen::RowVector3d;
using Terms = Eigen::Matrix<double, 1, 6>;

// \param level  on the top, in radii.
Terms TermsOf(const Eigen::Vector2d& level) {
  const double x = level.x();
  const double y = level.y();
  return Terms{{1, x, y, x * x, x * y, y * y}};
}

// Of the mean colour about a pixel: noise and grain are left out.
Color LogColor(const Image8& image, int x, int y) {
  Color sum = Color::Zero();
  for (int v = -kTextureRadius; v <= kTextureRadius; ++v) {
    for (int u = -kTextureRadius; u <= kTextureRadius; ++u) {
      const uint8_t* pixel = image.Pixel(x + u, y + v);
      sum += Color(pixel[0], pixel[1], pixel[2]);
    }
  }
  constexpr int kCount = (2 * kTextureRadius + 1) * (2 * kTextureRadius + 1);
  return (sum / kCount).cwiseMax(1).array().log();
}

bool IsOnRing(const Eigen::Vector2d& level) { return level.norm() > kRingInner && level.norm() < kRingOuter; }

// The middle of the shortest interval that holds a share of the values: shadows scatter, light does not. 0
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

std::optional<PlainTop::LitColor> PlainTop::LearnColor(const StationPhotos& station) const {
  const Eigen::Vector3d camera = station.views.front().cam_from_world.Inverse().translation;
  if (!((camera - table_.axis.point).dot(table_.axis.direction) > table_.high)) return std::nullopt;
  LitColor color;
  color.station = station.number;
  color.least_texture = LeastTexture(MeasurePictureNoise(station.images.data(), station.images.size()));
  std::vector<Terms> terms;
  std::vector<Color> colors;
  std::vector<uint8_t> is_ring;
  for (const TopPixel& pixel : PixelsOf(station.views.front())) {
    if (TextureAt(station.still, pixel.x, pixel.y) >= color.least_texture) continue;
    const Eigen::Vector2d level = LevelOf(pixel.x_in_world);
    terms.push_back(TermsOf(level));
    colors.push_back(LogColor(station.still, pixel.x, pixel.y));
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
      if (count == 6 && error.cwiseAbs().maxCoeff() > limit) continue;
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
    limit = kDeviations * std::max(kLeastDeviation, kSigmaOfMad * UpperMedian(std::move(errors)));
  }

  std::vector<double> errors;
  for (size_t i = 0; i < station.images.size(); ++i) {
    const std::vector<TopPixel> pixels = PixelsOf(station.views[i]);
    const std::vector<Color> of_photo = ErrorsOf(color, station.images[i], pixels);
    for (size_t k = 0; k < pixels.size(); ++k) {
      if (IsOnRing(LevelOf(pixels[k].x_in_world))) errors.push_back(of_photo[k].cwiseAbs().mean());
    }
  }
  // Half of a ring may be in shadows, but not three quarters.
  color.deviation = std::max(kLeastDeviation, kSigmaOfQuartile * Quantile(std::move(errors), 0.25));
  if (!(color.deviation < kMaxDeviation)) return std::nullopt;
  return color;
}

// Of the logarithms, less a photo's own exposure and white balance.
std::vector<Eigen::RowVector3d> PlainTop::ErrorsOf(const LitColor& color, const Image8& photo,
                                                   const std::vector<TopPixel>& pixels) const {
  std::vector<Color> errors;
  errors.reserve(pixels.size());
  std::array<std::vector<double>, 3> on_ring;
  for (const TopPixel& pixel : pixels) {
    const Eigen::Vector2d level = LevelOf(pixel.x_in_world);
    errors.emplace_back(LogColor(photo, pixel.x, pixel.y) - TermsOf(level) * color.terms);
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
  for (const StationPhotos& station : stations) {
    const std::optional<LitColor> color = top.LearnColor(station);
    if (color) top.colors_.push_back(*color);
  }
  if (top.colors_.empty()) return std::nullopt;
  return top;
}

std::vector<TopSight> PlainTop::Look(const Image8& photo, const PinholeView& view, int station) const {
  std::vector<TopSight> sights(static_cast<size_t>(view.width) * view.height, TopSight::kElsewhere);
  const auto color = std::find_if(colors_.begin(), colors_.end(),
                                  [&](const LitColor& other) { return other.station == station; });
  if (color == colors_.end()) return sights;
  const std::vector<TopPixel> pixels = PixelsOf(view);
  const std::vector<Color> errors = ErrorsOf(*color, photo, pixels);
  for (size_t i = 0; i < pixels.size(); ++i) {
    const bool is_plain = TextureAt(photo, pixels[i].x, pixels[i].y) < color->least_texture;
    sights[static_cast<size_t>(pixels[i].y) * view.width + pixels[i].x] =
        is_plain ? SightOf(*color, errors[i]) : TopSight::kOther;
  }
  return sights;
}

TopSight PlainTop::SightOf(const LitColor& color, const Color& error) {
  const double limit = kDeviations * color.deviation;
  if (error.cwiseAbs().maxCoeff() < limit) return TopSight::kLit;
  const double darkening = error.mean();
  if (!(darkening < 0 && darkening > std::log(kDarkest))) return TopSight::kOther;
  const bool has_tint = (error.array() - darkening).abs().maxCoeff() < limit / std::exp(darkening);
  return has_tint ? TopSight::kShadow : TopSight::kOther;
}

std::vector<std::vector<float>> RotatingDepths(const std::vector<StationPhotos>& stations, Backend* backend) {
  std::vector<std::vector<float>> depths;
  for (const StationPhotos& station : stations) {
    for (const PinholeView& view : station.views) {
      RenderRequest request;
      request.view = view;
      request.drawn = DrawnBody::kForeground;
      request.geometry = true;
      RenderedView rendered = backend->Render(request);
      for (size_t p = 0; p < rendered.alpha.size(); ++p) {
        if (rendered.alpha[p] < kOpaque) rendered.median_depth[p] = 0;
      }
      depths.push_back(std::move(rendered.median_depth));
    }
  }
  return depths;
}

std::vector<uint32_t> FindLayersOverTop(const PlainTop& top, const std::vector<StationPhotos>& stations,
                                        const std::vector<std::vector<float>>& depths,
                                        const Placement& gaussians) {
  struct Witness {
    const PinholeView* view;
    const std::vector<float>* depths;
    std::vector<TopSight> sights;
  };
  std::vector<Witness> witnesses;
  double pixel_size = 0;
  const RotatingRegion& table = top.table();
  for (const StationPhotos& station : stations) {
    for (size_t i = 0; i < station.views.size(); ++i) {
      const PinholeView& view = station.views[i];
      witnesses.push_back(
          {&view, &depths[witnesses.size()], top.Look(station.images[i], view, station.number)});
      pixel_size = std::max(pixel_size, (view.cam_from_world * table.axis.point).z() / view.fx);
    }
  }
  std::vector<uint8_t> is_layer(gaussians.size(), 0);
  constexpr int64_t kAtOnce = 1000;  // that one thread looks at
  ParallelFor(static_cast<int64_t>(gaussians.size()), 0, kAtOnce, [&](int64_t gaussian) {
    const auto i = static_cast<size_t>(gaussian);
    const float* centre = gaussians.centre.data() + 3 * i;
    const Eigen::Vector3d x(centre[0], centre[1], centre[2]);
    if (!x.allFinite() || !IsForeground(gaussians.foreground_logit[i])) return;
    const double height = (x - table.axis.point).dot(table.axis.direction) - table.high;
    if (!(height > pixel_size) ||
        (x - table.axis.point - (height + table.high) * table.axis.direction).norm() > table.radius)
      return;
    int lit = 0;
    int other = 0;
    for (const Witness& witness : witnesses) {
      const PinholeView& view = *witness.view;
      const Eigen::Vector3d x_in_cam = view.cam_from_object * x;
      const std::optional<Eigen::Vector2d> pixel = PixelOf(view, x_in_cam);
      if (!pixel ||
          !(pixel->x() >= 0 && pixel->y() >= 0 && pixel->x() < view.width && pixel->y() < view.height))
        continue;
      const size_t p = static_cast<size_t>(pixel->y()) * view.width + static_cast<size_t>(pixel->x());
      // A photo that sees the top refutes all that is before it.
      const float depth = (*witness.depths)[p];
      const bool is_hidden = depth > 0 && x_in_cam.z() > depth + kBehind * pixel_size;
      lit += witness.sights[p] == TopSight::kLit ? 1 : 0;
      other += witness.sights[p] == TopSight::kOther && !is_hidden ? 1 : 0;
    }
    is_layer[i] = lit >= kLeastLit && kOtherPerLit * lit > other ? 1 : 0;
  });
  std::vector<uint32_t> layers;
  for (size_t i = 0; i < is_layer.size(); ++i) {
    if (is_layer[i] != 0) layers.push_back(static_cast<uint32_t>(i));
  }
  return layers;
}

}  // namespace s2gs
