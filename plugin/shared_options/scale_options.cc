#include "plugin/shared_options/scale_options.h"

#include <fmt/format.h>

#include <exception>
#include <stdexcept>

namespace s2gs {

OptionCheck ScaleOptions::Check() const {
  if (!(disc_diameter_mm >= 0) || !(disc_diameter_mm <= 1e6)) {
    return OptionFault{"disc_diameter_mm", fmt::format("{}", disc_diameter_mm),
                       "0 <= disc_diameter_mm <= 1000000"};
  }
  if (!(marker_size_mm >= 0) || !(marker_size_mm <= 1e5)) {
    return OptionFault{"marker_size_mm", fmt::format("{}", marker_size_mm), "0 <= marker_size_mm <= 100000"};
  }
  if (!(known_length_mm >= 0) || !(known_length_mm <= 1e6)) {
    return OptionFault{"known_length_mm", fmt::format("{}", known_length_mm),
                       "0 <= known_length_mm <= 1000000"};
  }
  return std::nullopt;
}

void AddScaleOptions(Options* options, ScaleOptions* scale) {
  auto own = options->Fields(scale);
  own.Add("marker_size_mm", &ScaleOptions::marker_size_mm,
          "side of the black squares of printed markers (ArUco, AprilTag) that lie on the table or stand in "
          "the background; 0: no markers")
      .Unit("mm");
  options->Add("marker_dictionary", &scale->marker_dictionary,
               "4X4, 5X5, 6X6, 7X7, ARUCO_ORIGINAL, APRILTAG_16H5, APRILTAG_25H9, APRILTAG_36H10 or "
               "APRILTAG_36H11; auto: the one of which most are seen");
  options->Add("marker_ids", &scale->marker_ids, "use these markers alone; empty: all that are found");
  own.Add("known_length_mm", &ScaleOptions::known_length_mm,
          "distance of two points of the rotating part; 0: none")
      .Unit("mm");
  options->Add("point_a", &scale->point_a,
               "the first point where photos show it: NAME:X:Y in pixels, two or more");
  options->Add("point_b", &scale->point_b, "the second point, in the same way");
  own.Add("disc_diameter_mm", &ScaleOptions::disc_diameter_mm,
          "diameter of a round disc that turns about its middle; 0: not known")
      .Unit("mm");
  options->Add(
      "disc_rim", &scale->disc_rim,
      "places on that disc's rim, NAME:X:Y in pixels, three or more, of its near and of its far side; "
      "in which photos does not matter");
  options->Add("charuco_columns", &scale->charuco_columns,
               "squares across of a ChArUco board on the table; 0: there is none");
  options->Add("charuco_rows", &scale->charuco_rows, "squares down");
  options
      ->Add("charuco_square_mm", &scale->charuco_square_mm,
            "side of its squares; --marker_size_mm is that of its markers, which are numbered from 0")
      .Unit("mm");
}

std::vector<PhotoPlace> ParsePhotoPlaces(const std::vector<std::string>& texts, const std::string& option) {
  std::vector<PhotoPlace> places;
  for (const std::string& text : texts) {
    const size_t last = text.rfind(':');
    const size_t middle = last == std::string::npos || last == 0 ? last : text.rfind(':', last - 1);
    try {
      if (middle == std::string::npos || middle == last) throw std::invalid_argument(text);
      size_t end_x = 0;
      size_t end_y = 0;
      const std::string x = text.substr(middle + 1, last - middle - 1);
      const std::string y = text.substr(last + 1);
      places.push_back({text.substr(0, middle), std::stod(x, &end_x), std::stod(y, &end_y)});
      if (end_x != x.size() || end_y != y.size()) throw std::invalid_argument(text);
    } catch (const std::exception&) {
      throw CommandLineError(
          fmt::format("--{}: \"{}\" is not NAME:X:Y, a photo's name and pixels in it.", option, text));
    }
  }
  return places;
}

void RequireComplete(const ScaleOptions& scale) {
  if ((scale.known_length_mm > 0) != (!scale.point_a.empty() && !scale.point_b.empty())) {
    throw CommandLineError("--known_length_mm, --point_a and --point_b belong together.");
  }
  if ((scale.disc_diameter_mm > 0) != !scale.disc_rim.empty()) {
    throw CommandLineError("--disc_diameter_mm and --disc_rim belong together.");
  }
  ParsePhotoPlaces(scale.point_a, "point_a");
  ParsePhotoPlaces(scale.point_b, "point_b");
  ParsePhotoPlaces(scale.disc_rim, "disc_rim");
}

std::vector<std::string> ScaleArguments(const ScaleOptions& scale) {
  std::vector<std::string> arguments;
  const auto add = [&](const char* name, const auto& value, bool is_stated) {
    if (is_stated) arguments.insert(arguments.end(), {name, FormatValue(value)});
  };
  add("--marker_size_mm", scale.marker_size_mm, scale.marker_size_mm > 0);
  add("--marker_dictionary", scale.marker_dictionary, scale.marker_dictionary != "auto");
  add("--marker_ids", scale.marker_ids, !scale.marker_ids.empty());
  add("--known_length_mm", scale.known_length_mm, scale.known_length_mm > 0);
  add("--point_a", scale.point_a, !scale.point_a.empty());
  add("--point_b", scale.point_b, !scale.point_b.empty());
  add("--disc_diameter_mm", scale.disc_diameter_mm, scale.disc_diameter_mm > 0);
  add("--disc_rim", scale.disc_rim, !scale.disc_rim.empty());
  add("--charuco_columns", scale.charuco_columns, scale.charuco_columns > 0);
  add("--charuco_rows", scale.charuco_rows, scale.charuco_rows > 0);
  add("--charuco_square_mm", scale.charuco_square_mm, scale.charuco_square_mm > 0);
  return arguments;
}

}  // namespace s2gs
