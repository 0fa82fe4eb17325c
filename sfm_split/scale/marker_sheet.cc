#include "sfm_split/scale/marker_sheet.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <random>

#include "sfm_split/base/angles.h"
#include "sfm_split/scale/markers.h"

namespace s2gs {
namespace {

// White around a marker, in its cells: detectors need one.
constexpr double kQuietCells = 1.5;
// From the rim to the markers' outer corners [mm]: what scissors need.
constexpr double kRim = 4;
// White between speckles [mm].
constexpr double kSpeckleGap = 0.6;
// Tries for places of speckles, for each square millimetre over the square of the size.
constexpr double kTriesPerPlace = 12;

// std's distributions differ between libraries.
class Numbers {
 public:
  explicit Numbers(uint64_t seed) : engine_(seed) {}
  double Uniform(double low, double high) {
    return low + (high - low) * static_cast<double>(engine_() >> 11) * 0x1p-53;
  }

 private:
  std::mt19937_64 engine_;
};

}  // namespace

OptionCheck MarkerSheetOptions::Check() const {
  const auto fault = [](const char* field, double value, const char* bound) {
    return OptionFault{field, fmt::format("{}", value), bound};
  };
  if (!(diameter_mm >= 50) || !(diameter_mm <= 3000))
    return fault("diameter_mm", diameter_mm, "50 <= diameter_mm <= 3000");
  if (!(marker_size_mm >= 4) || !(marker_size_mm <= 500))
    return fault("marker_size_mm", marker_size_mm, "4 <= marker_size_mm <= 500");
  if (!(hole_diameter_mm >= 0) || !(hole_diameter_mm <= 3000)) {
    return fault("hole_diameter_mm", hole_diameter_mm, "0 <= hole_diameter_mm <= 3000");
  }
  if (first_id < 0 || first_id > 100000) return fault("first_id", first_id, "0 <= first_id <= 100000");
  if (!(speckle_size_mm >= 0) || !(speckle_size_mm <= 50))
    return fault("speckle_size_mm", speckle_size_mm, "0 <= speckle_size_mm <= 50");
  return std::nullopt;
}

MarkerSheet MakeMarkerSheet(const MarkerSheetOptions& options, uint64_t seed) {
  const double cell =
      options.marker_size_mm / CellsOfMarker(options.marker_dictionary, options.first_id).side;
  const double half = options.marker_size_mm / 2;
  const double quiet = half + kQuietCells * cell;  // half of a marker with its white
  const double rim = options.diameter_mm / 2 - kRim;
  // The outer corners lie on the rim: (distance + half)^2 + half^2 = rim^2.
  const double distance = rim > half ? std::sqrt(rim * rim - half * half) - half : 0;
  // Neighbours' inner corners do not touch: half the angle between them sees half of the side from inside.
  const double inner = distance - quiet;
  const int count = inner > 0 ? static_cast<int>(std::floor(kPi / std::atan2(quiet, inner))) : 0;
  if (count < 3 || inner < options.hole_diameter_mm / 2) {
    throw UserError(
        fmt::format("markers of {} mm do not fit around a sheet of {} mm: give a smaller --marker_size_mm or "
                    "--hole_diameter_mm, or a larger --diameter_mm",
                    options.marker_size_mm, options.diameter_mm));
  }
  CellsOfMarker(options.marker_dictionary, options.first_id + count - 1);
  MarkerSheet sheet;
  for (int i = 0; i < count; ++i) {
    const double angle = 2 * kPi * i / count;
    sheet.markers.push_back(
        {options.first_id + i, {distance * std::cos(angle), distance * std::sin(angle)}, angle});
  }
  if (options.speckle_size_mm <= 0) return sheet;
  Numbers numbers(seed);
  const double size = options.speckle_size_mm;
  const auto tries =
      static_cast<int64_t>(kTriesPerPlace * options.diameter_mm * options.diameter_mm / (size * size));
  for (int64_t i = 0; i < tries; ++i) {
    MarkerSheet::Speckle speckle;
    speckle.center = {numbers.Uniform(-rim, rim), numbers.Uniform(-rim, rim)};
    speckle.radius = size / 2 * numbers.Uniform(0.25, 1);
    speckle.grey = static_cast<int>(numbers.Uniform(0, 150));
    const double from_middle = speckle.center.norm();
    bool is_free =
        from_middle + speckle.radius < rim && from_middle - speckle.radius > options.hole_diameter_mm / 2;
    for (const MarkerSheet::Marker& marker : sheet.markers) {
      const Eigen::Vector2d offset = speckle.center - marker.center;
      const double along =
          std::abs(std::cos(marker.angle) * offset.x() + std::sin(marker.angle) * offset.y());
      const double across =
          std::abs(std::cos(marker.angle) * offset.y() - std::sin(marker.angle) * offset.x());
      is_free = is_free && std::max(along, across) > quiet + speckle.radius;
    }
    for (size_t k = 0; k < sheet.speckles.size() && is_free; ++k) {
      const MarkerSheet::Speckle& other = sheet.speckles[k];
      is_free = (other.center - speckle.center).norm() > other.radius + speckle.radius + kSpeckleGap;
    }
    if (is_free) sheet.speckles.push_back(speckle);
  }
  return sheet;
}

void WriteMarkerSheet(std::ostream& stream, const MarkerSheet& sheet, const MarkerSheetOptions& options) {
  const double side = options.diameter_mm;
  stream << fmt::format(
      "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{0}mm\" height=\"{0}mm\" viewBox=\"{1} {1} {0} "
      "{0}\">\n"
      "<title>{2} markers {3} to {4}, side {5} mm: print at 100 %</title>\n"
      "<circle r=\"{6}\" fill=\"white\" stroke=\"black\" stroke-width=\"0.2\"/>\n",
      side, -side / 2, options.marker_dictionary, sheet.markers.front().id, sheet.markers.back().id,
      options.marker_size_mm, side / 2 - 0.1);
  for (const MarkerSheet::Speckle& speckle : sheet.speckles) {
    stream << fmt::format("<circle cx=\"{:.3f}\" cy=\"{:.3f}\" r=\"{:.3f}\" fill=\"#{:02x}{:02x}{:02x}\"/>\n",
                          speckle.center.x(), speckle.center.y(), speckle.radius, speckle.grey, speckle.grey,
                          speckle.grey);
  }
  for (const MarkerSheet::Marker& marker : sheet.markers) {
    const MarkerCells cells = CellsOfMarker(options.marker_dictionary, marker.id);
    stream << fmt::format(
        "<g transform=\"translate({:.5f} {:.5f}) rotate({:.5f}) scale({:.8f}) translate({} {})\">"
        "<rect width=\"{}\" height=\"{}\" fill=\"black\"/>",
        marker.center.x(), marker.center.y(), marker.angle * 180 / kPi, options.marker_size_mm / cells.side,
        -cells.side / 2.0, -cells.side / 2.0, cells.side, cells.side);
    for (int row = 0; row < cells.side; ++row) {
      for (int column = 0; column < cells.side; ++column) {
        if (cells.is_white[static_cast<size_t>(row) * cells.side + column] == 0) continue;
        stream << fmt::format("<rect x=\"{}\" y=\"{}\" width=\"1\" height=\"1\" fill=\"white\"/>", column,
                              row);
      }
    }
    stream << "</g>\n";
  }
  stream << "</svg>\n";
}

}  // namespace s2gs
