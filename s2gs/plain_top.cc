#include "s2gs/plain_top.h"

#include <Eigen/Dense>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstddef>

#include "s2gs/image/picture_noise.h"
#include "s2gs/opaque_region.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

constexpr double kRingInner = 0.8;  // of the radius: next to the rim hardly anything stands.
constexpr double kRingOuter = 0.97;
constexpr int kLeastPixels = 100;      // of a ring, for its colour
constexpr int kRounds = 6;             // of robust fits
constexpr double kDeviations = 3;      // of noise and of the fit: another colour.
constexpr double kMaxDeviation = 0.1;  // of the logarithm on a ring: not one smooth colour.
constexpr double kDarkest = 0.2;       // of the lit colour, in a shadow
constexpr double kMaxHeight = 0.2;     // [radii], of what may be a plain surface's wrong shape
constexpr double kWhite = 255;
constexpr int kLeastLooks = 8;  // pixels of photos at a place
constexpr int kCells = 32;      // across the table

using Color = Eigen::RowVector3d;
using Terms = Eigen::Matrix<double, 1, 6>;

// \param level  on the top, in radii.
Terms TermsOf(const Eigen::Vector2d& level) {
  const double x = level.x();
  const double y = level.y();
  return Terms{{1, x, y, x * x, x * y, y * y}};
}

Color LogColor(const uint8_t* pixel) {
  return {std::log(std::max<int>(1, pixel[0])), std::log(std::max<int>(1, pixel[1])),
          std::log(std::max<int>(1, pixel[2]))};
}

// A photo's pixel on the top.
struct TopPixel {
  size_t index = 0;
  int x = 0, y = 0;
  bool is_at_rim = false;  // a patch about it shows what lies beyond.
  Eigen::Vector3d x_in_cam;
};

std::vector<TopPixel> PixelsOfTop(const RotatingRegion& top, const PinholeView& view) {
  const RegionView seen(top, view);
  std::vector<TopPixel> pixels;
  for (int y = kTextureRadius; y + kTextureRadius < view.height; ++y) {
    for (int x = kTextureRadius; x + kTextureRadius < view.width; ++x) {
      const std::optional<RegionHit> hit = seen.At(x, y);
      if (!hit) continue;
      const Eigen::Vector3d ray((x + 0.5 - view.cx) / view.fx, (y + 0.5 - view.cy) / view.fy, 1);
      const bool is_inner = seen.At(x - kTextureRadius, y) && seen.At(x + kTextureRadius, y) &&
                            seen.At(x, y - kTextureRadius) && seen.At(x, y + kTextureRadius);
      pixels.push_back({static_cast<size_t>(y) * view.width + x, x, y, !is_inner, hit->depth * ray});
    }
  }
  return pixels;
}

}  // namespace

PlainTop::PlainTop(const RotatingRegion& table) : table_(table), top_(table) {
  top_.low = top_.high;
  along_x_ = table.axis.direction.unitOrthogonal();
  along_y_ = table.axis.direction.cross(along_x_);
  lit_.assign(size_t{kCells} * kCells, 0);
  looked_ = lit_;
}

Eigen::Vector2d PlainTop::LevelOf(const Eigen::Vector3d& x) const {
  const Eigen::Vector3d from_axis = x - table_.axis.point;
  return Eigen::Vector2d(from_axis.dot(along_x_), from_axis.dot(along_y_)) / table_.radius;
}

std::optional<PlainTop::LitColor> PlainTop::LearnColor(const StationPhotos& station) const {
  const PinholeView& view = station.views.front();
  const Rigid3 world_from_cam = view.cam_from_world.Inverse();
  LitColor color;
  color.station = station.number;
  const PictureNoise noise = MeasurePictureNoise(station.images.data(), station.images.size());
  color.least_texture = LeastTexture(noise);
  color.noise = noise.of_grey;

  std::vector<Terms> terms;
  std::vector<Color> colors;
  std::vector<uint8_t> is_ring;
  int num_ring = 0;
  for (const TopPixel& pixel : PixelsOfTop(top_, view)) {
    if (pixel.is_at_rim || TextureAt(station.still, pixel.x, pixel.y) >= color.least_texture) continue;
    const Eigen::Vector2d level = LevelOf(world_from_cam * pixel.x_in_cam);
    terms.push_back(TermsOf(level));
    colors.push_back(LogColor(station.still.Pixel(pixel.x, pixel.y)));
    const double distance = level.norm();
    is_ring.push_back(distance > kRingInner && distance < kRingOuter ? 1 : 0);
    num_ring += is_ring.back();
  }
  if (num_ring < kLeastPixels) return std::nullopt;

  // A ring by itself does not tell how light bends within it: a slope first, from there inwards.
  double limit = kMaxDeviation;
  for (int round = 0; round < kRounds; ++round) {
    const int count = round < kRounds / 2 ? 3 : 6;
    Eigen::MatrixXd squares = Eigen::MatrixXd::Zero(count, count);
    Eigen::MatrixXd products = Eigen::MatrixXd::Zero(count, 3);
    for (size_t i = 0; i < terms.size(); ++i) {
      if (count == 3 && is_ring[i] == 0) continue;
      const Color error = colors[i] - terms[i] * color.terms;
      if (count == 6 && error.cwiseAbs().maxCoeff() > limit) continue;
      // What a shadow or a thing covers pulls little (Cauchy's weights); at first nothing is known.
      const double weight = round == 0 ? 1 : 1 / (1 + error.squaredNorm() / (limit * limit));
      const auto term = terms[i].head(count);
      squares += weight * term.transpose() * term;
      products += weight * term.transpose() * colors[i];
    }
    const Eigen::LDLT<Eigen::MatrixXd> solver(squares);
    if (solver.info() != Eigen::Success || !(solver.rcond() > 1e-9)) return std::nullopt;
    color.terms.topRows(count) = solver.solve(products);
    std::vector<double> errors;
    for (size_t i = 0; i < terms.size(); ++i) {
      if (is_ring[i] == 0) continue;
      const Color error = colors[i] - terms[i] * color.terms;
      for (int k = 0; k < 3; ++k) errors.push_back(std::abs(error[k]));
    }
    color.deviation = kSigmaOfMad * Quantile(std::move(errors), 0.5);
    limit = kDeviations * std::max<double>(color.deviation, color.noise / kWhite);
  }
  if (!(color.deviation < kMaxDeviation)) return std::nullopt;
  return color;
}

std::optional<PlainTop> PlainTop::Learn(const std::vector<StationPhotos>& stations,
                                        const RotatingRegion& table) {
  PlainTop top(table);
  for (const StationPhotos& station : stations) {
    const std::optional<LitColor> color = top.LearnColor(station);
    if (!color) continue;
    top.colors_.push_back(*color);
    top.CountBare(station);
  }
  if (top.colors_.empty()) return std::nullopt;
  return top;
}

std::vector<TopSight> PlainTop::Look(const Image8& photo, const PinholeView& view, int station) const {
  std::vector<TopSight> sights(static_cast<size_t>(view.width) * view.height, TopSight::kOther);
  const auto color = std::find_if(colors_.begin(), colors_.end(),
                                  [&](const LitColor& other) { return other.station == station; });
  if (color == colors_.end()) return sights;
  const Rigid3 world_from_cam = view.cam_from_world.Inverse();
  const std::vector<TopPixel> pixels = PixelsOfTop(top_, view);
  std::vector<Color> lit(pixels.size());
  std::vector<Color> errors(pixels.size());
  std::array<std::vector<double>, 3> on_ring;
  for (size_t i = 0; i < pixels.size(); ++i) {
    const Eigen::Vector2d level = LevelOf(world_from_cam * pixels[i].x_in_cam);
    lit[i] = TermsOf(level) * color->terms;
    errors[i] = LogColor(photo.Pixel(pixels[i].x, pixels[i].y)) - lit[i];
    if (!(level.norm() > kRingInner && level.norm() < kRingOuter)) continue;
    for (int k = 0; k < 3; ++k) on_ring[k].push_back(errors[i][k]);
  }
  // A photo's own exposure and white balance.
  Color gain;
  for (int k = 0; k < 3; ++k) gain[k] = UpperMedian(on_ring[k]);
  for (size_t i = 0; i < pixels.size(); ++i) {
    // At the rim the colour alone has to tell.
    if (!pixels[i].is_at_rim && TextureAt(photo, pixels[i].x, pixels[i].y) >= color->least_texture) continue;
    sights[pixels[i].index] = SightOf(*color, lit[i] + gain, errors[i] - gain);
  }
  return sights;
}

TopSight PlainTop::SightOf(const LitColor& color, const Color& lit, const Color& error) {
  const double darkening = std::min(0.0, error.mean());
  bool is_lit = true;
  bool is_shadow = darkening > std::log(kDarkest);
  for (int k = 0; k < 3; ++k) {
    const double noise = color.noise / std::exp(lit[k]);
    is_lit = is_lit && std::abs(error[k]) < kDeviations * std::hypot(color.deviation, noise);
    is_shadow = is_shadow && std::abs(error[k] - darkening) <
                                 kDeviations * std::hypot(color.deviation, noise / std::exp(darkening));
  }
  return is_lit ? TopSight::kLit : is_shadow ? TopSight::kShadow : TopSight::kOther;
}

void PlainTop::CountBare(const StationPhotos& station) {
  for (size_t i = 0; i < station.views.size(); ++i) {
    const PinholeView& view = station.views[i];
    const std::vector<TopSight> sights = Look(station.images[i], view, station.number);
    const Rigid3 object_from_cam = view.cam_from_object.Inverse();
    for (const TopPixel& pixel : PixelsOfTop(top_, view)) {
      const std::optional<size_t> cell = CellOf(object_from_cam * pixel.x_in_cam);
      if (!cell) continue;
      ++looked_[*cell];
      lit_[*cell] += sights[pixel.index] == TopSight::kLit ? 1 : 0;
    }
  }
}

std::optional<size_t> PlainTop::CellOf(const Eigen::Vector3d& x_in_object) const {
  const Eigen::Vector2d cell = (kCells / 2.0) * (LevelOf(x_in_object).array() + 1);
  if (!(cell.minCoeff() >= 0 && cell.maxCoeff() < kCells)) return std::nullopt;
  return static_cast<size_t>(cell.y()) * kCells + static_cast<size_t>(cell.x());
}

bool PlainTop::IsBare(const Eigen::Vector3d& x_in_object) const {
  const std::optional<size_t> cell = CellOf(x_in_object);
  return cell && looked_[*cell] >= kLeastLooks && 2 * lit_[*cell] > looked_[*cell];
}

double PlainTop::BareShare() const {
  int64_t bare = 0;
  int64_t seen = 0;
  for (size_t cell = 0; cell < lit_.size(); ++cell) {
    if (looked_[cell] < kLeastLooks) continue;
    ++seen;
    bare += 2 * lit_[cell] > looked_[cell] ? 1 : 0;
  }
  return seen > 0 ? static_cast<double>(bare) / static_cast<double>(seen) : 0;
}

void DrawPlainTop(const PlainTop& top, const std::vector<TopSight>& sights, const PinholeView& view,
                  RenderedView* rendered) {
  const PinholeView looked = StationView(view);
  RotatingRegion surface = top.table();
  surface.low = surface.high;
  const RegionView seen(surface, view);
  const Rigid3 object_from_cam = view.cam_from_object.Inverse();
  for (int y = 0; y < rendered->height; ++y) {
    for (int x = 0; x < rendered->width; ++x) {
      const auto column = static_cast<size_t>((x + 0.5) * looked.width / view.width);
      const auto row = static_cast<size_t>((y + 0.5) * looked.height / view.height);
      const TopSight sight = sights[row * looked.width + column];
      if (sight == TopSight::kOther) continue;
      const std::optional<RegionHit> hit = seen.At(x, y);
      if (!hit) continue;
      const size_t i = static_cast<size_t>(y) * rendered->width + x;
      if (rendered->alpha[i] >= kOpaque && rendered->median_depth[i] > 0) {
        const Eigen::Vector3d ray((x + 0.5 - view.cx) / view.fx, (y + 0.5 - view.cy) / view.fy, 1);
        const Eigen::Vector3d drawn = object_from_cam * (rendered->median_depth[i] * ray);
        const Eigen::Vector3d from_axis = drawn - surface.axis.point;
        const double height = from_axis.dot(surface.axis.direction);
        if (height - surface.high > kMaxHeight * surface.radius) continue;
        // Nothing stands beside the table, but only its own light tells that what hides it is not there.
        const bool is_beside = (from_axis - height * surface.axis.direction).norm() > surface.radius;
        if (!(is_beside ? sight == TopSight::kLit : top.IsBare(drawn))) continue;
      }
      rendered->alpha[i] = 1;
      rendered->median_depth[i] = rendered->expected_depth[i] = static_cast<float>(hit->depth);
      for (int k = 0; k < 3; ++k) rendered->normal[3 * i + k] = static_cast<float>(hit->normal[k]);
    }
  }
}

}  // namespace s2gs
