#include "plugin/commands/marker_sheet_command.h"

#include <fmt/format.h>

#include <filesystem>
#include <ostream>

#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/scale/marker_sheet.h"

namespace s2gs {

void RunMarkerSheet(CommandContext& context) {
  std::filesystem::path output_path;
  MarkerSheetOptions sheet_options;
  Options& options = context.Declare(
      "Draws a round sheet for the table, to print at 100 %: markers along its rim, by which model_scaler "
      "makes the "
      "scene metric, and speckle that helps objects with little texture. Measure a marker after printing, "
      "and give that "
      "as --marker_size_mm.",
      "--output_path sheet.svg --diameter_mm 280 --marker_size_mm 25");
  options.Add("output_path", &output_path, "the sheet, .svg, in millimetres").Required();
  auto group = options.Fields(&sheet_options);
  group.Add("diameter_mm", &MarkerSheetOptions::diameter_mm, "of the sheet").Unit("mm");
  group.Add("marker_size_mm", &MarkerSheetOptions::marker_size_mm, "side of the markers' black squares")
      .Unit("mm");
  group.Add("hole_diameter_mm", &MarkerSheetOptions::hole_diameter_mm, "leave this much blank in the middle")
      .Unit("mm");
  group.Add("marker_dictionary", &MarkerSheetOptions::marker_dictionary, "as model_scaler has it");
  group.Add("first_id", &MarkerSheetOptions::first_id, "number of the first marker");
  group
      .Add("speckle_size_mm", &MarkerSheetOptions::speckle_size_mm,
           "diameter of the largest speckles; 0: none")
      .Unit("mm");
  context.Parse();
  if (output_path.extension() != ".svg")
    throw UserError(output_path, "is no name for a sheet", "Choose one that ends in .svg");
  const MarkerSheet sheet = MakeMarkerSheet(sheet_options, options.random_seed());
  WriteFileAtomically(output_path,
                      [&](std::ostream& stream) { WriteMarkerSheet(stream, sheet, sheet_options); });
  context.out() << fmt::format("markers          {} to {} of {}, {} mm\n", sheet.markers.front().id,
                               sheet.markers.back().id, sheet_options.marker_dictionary,
                               sheet_options.marker_size_mm)
                << fmt::format("speckles         {}\n", sheet.speckles.size()) << "written          "
                << output_path.string() << '\n';
}

}  // namespace s2gs
