#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <set>
#include <system_error>

#include "plugin/report/data_uri.h"
#include "plugin/report/sections.h"
#include "s2gs/image/exif.h"
#include "s2gs/image/photos.h"
#include "s2gs/render_pictures.h"
#include "sfm_split/base/error.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

constexpr size_t kMaxOverlays = 4;
constexpr int kOverlaySide = 420;  // [px]
constexpr int kPanelSide = 480;    // [px]
constexpr int kQuality = 78;
constexpr size_t kMostBytes = 45000;  // of a picture: twenty take less than a megabyte
// As comparison.jpg has them from left to right (s2gs/render_pictures.h).
constexpr int kNumPanels = 4;

std::vector<fs::path> Overlays(const fs::path& folder) {
  std::vector<fs::path> paths;
  std::error_code ec;
  fs::recursive_directory_iterator entry(folder, fs::directory_options::skip_permission_denied, ec);
  for (const fs::recursive_directory_iterator end; !ec && entry != end; entry.increment(ec)) {
    std::error_code file_ec;
    if (entry->is_regular_file(file_ec) && entry->path().extension() == ".jpg")
      paths.push_back(entry->path());
  }
  std::sort(paths.begin(), paths.end());
  return paths;
}

void WriteOverlays(const ReportInput& input, Reporter& reporter, ReportSection* section) {
  HtmlWriter& out = section->html;
  const std::vector<fs::path> paths = Overlays(input.workspace.SplitOverlays());
  out.Element("h3", "Keypoints by body");
  if (paths.empty()) {
    WriteMissing("There are no overlays: motion_splitter draws them into split/overlays.", &out);
    return;
  }
  out.Open("div", {{"class", "pictures"}});
  const size_t count = std::min(kMaxOverlays, paths.size());
  for (size_t i = 0; i < count; ++i) {
    const fs::path& path = paths[i * paths.size() / count];
    const std::string name = path.lexically_relative(input.workspace.SplitOverlays()).generic_string();
    try {
      const std::string uri = JpegDataUri(Thumbnail(ReadImage(path, 3), kOverlaySide), kQuality, kMostBytes);
      out.Open("figure").Void("img", {{"src", uri}, {"alt", "keypoints of " + name}});
      out.Element("figcaption", name).Close();
      section->numbers["overlays"].push_back(name);
    } catch (const UserError& error) {
      reporter.Warn(std::string("no picture: ") + error.what());
    }
  }
  out.Close();
  out.Element("p", "Orange: rotating part; blue: background; small and grey: unknown.", {{"class", "note"}});
}

// Rows of photo, rendering, error and mask below each other, all of one size; none when the picture has
// another shape than that of whole rows.
std::vector<Image8> ComparisonPanels(const Image8& picture, size_t num_rows) {
  std::vector<Image8> panels;
  const int width = picture.width / kNumPanels;
  const int height = num_rows > 0 ? picture.height / static_cast<int>(num_rows) : 0;
  if (width == 0 || height == 0 || picture.height % height != 0) return panels;
  for (size_t row = 0; row < num_rows; ++row) {
    for (int p = 0; p < kNumPanels; ++p) {
      panels.push_back(CutAndShrink(picture, {p * width, static_cast<int>(row) * height, width, height}, 1));
    }
  }
  return panels;
}

// The photos of s2gs/comparison.jpg; none unless the renderer drew them all at one size.
std::vector<std::string> ComparedPhotos(const ReportInput& input) {
  std::vector<std::string> names;
  std::set<std::pair<uint64_t, uint64_t>> sizes;
  if (!input.object) return names;
  for (const std::string& name : input.photos) {
    const ColmapImage* image = input.ObjectImage(name);
    if (image == nullptr || (input.turntable && input.TableImage(name) == nullptr)) continue;
    names.push_back(name);
    const Camera& camera = input.object->cameras.at(image->camera_id);
    const Camera pinhole = PlanUndistortion(camera, input.workspace.ObjectModel()).pinhole;
    sizes.insert({pinhole.width, pinhole.height});
  }
  if (sizes.size() != 1) return {};
  std::vector<std::string> compared;
  for (const size_t i : OverviewPhotos(names.size())) compared.push_back(names[i]);
  return compared;
}

// Each panel of each photo, upright; the script shows two of them over each other.
void WritePanels(const ReportInput& input, const std::vector<Image8>& panels,
                 const std::vector<std::string>& names, HtmlWriter* out) {
  for (size_t i = 0; i < panels.size(); ++i) {
    const size_t row = i / kNumPanels;
    const size_t panel = i % kNumPanels;
    static constexpr const char* kNames[kNumPanels] = {"photo", "rendering", "error", "mask"};
    const Image8 small = Thumbnail(panels[i], kPanelSide);
    const int orientation = ReadOrientation(input.image_path / names[row]);
    HtmlAttributes attributes = {{"src", JpegDataUri(TurnUpright(small, orientation), kQuality, kMostBytes)},
                                 {"alt", fmt::format("{}: {}", names[row], kNames[panel])},
                                 {"data-row", std::to_string(row)},
                                 {"data-panel", std::to_string(panel)}};
    // Without the script the first photo and its rendering show.
    if (row != 0 || panel > 1) attributes.emplace_back("hidden", "");
    if (panel != 0) attributes.emplace_back("class", "over");
    out->Void("img", attributes);
  }
}

void WriteComparison(const ReportInput& input, Reporter& reporter, ReportSection* section) {
  HtmlWriter& out = section->html;
  out.Element("h3", "Photo against model");
  std::error_code ec;
  if (!fs::exists(input.workspace.Overview(), ec)) {
    WriteMissing("There is no comparison yet: gaussian_renderer draws it from the trained model.", &out);
    return;
  }
  Image8 picture;
  std::vector<std::string> names;
  try {
    picture = ReadImage(input.workspace.Overview(), 3);
    names = ComparedPhotos(input);
  } catch (const UserError& error) {
    reporter.Warn(std::string("no picture: ") + error.what());
    WriteMissing("The comparison cannot be read.", &out);
    return;
  }
  const std::vector<Image8> panels = ComparisonPanels(picture, names.size());
  if (panels.empty()) {
    const std::string uri = JpegDataUri(Thumbnail(picture, 1200), kQuality);
    out.Void("img",
             {{"class", "whole"}, {"src", uri}, {"alt", "photo, rendering, error and mask of some photos"}});
    return;
  }
  out.Open("div", {{"class", "compare"}, {"id", "compare"}});
  out.Open("p", {{"class", "controls"}});
  out.Open("span").Text("Photo against ");
  // The panels' order in the file is photo, rendering, error, mask.
  for (const auto& [panel, label] :
       {std::pair("1", "rendering"), std::pair("3", "mask"), std::pair("2", "error × 4")}) {
    out.Element("button", label, {{"type", "button"}, {"data-panel", panel}});
  }
  out.Close().Open("span").Text(" of ");
  for (size_t row = 0; row < names.size(); ++row) {
    out.Element("button", names[row], {{"type", "button"}, {"data-row", std::to_string(row)}});
  }
  out.Close().Close();
  out.Open("div", {{"class", "stage"}});
  WritePanels(input, panels, names, &out);
  out.Void("input", {{"type", "range"},
                     {"min", "0"},
                     {"max", "100"},
                     {"value", "50"},
                     {"step", "0.5"},
                     {"aria-label", "how much of the photo shows"}});
  out.Close().Close();
  section->numbers["compared"] = names;
}

// What the photos say of the pixels that the rotating part covers; the last line of the log counts.
void WriteSights(const ReportInput& input, ReportSection* section) {
  const nlohmann::json* sights = nullptr;
  for (const nlohmann::json& line : input.log) {
    if (line.is_object() && line.value("event", nlohmann::json()) == "sights") sights = &line;
  }
  if (sights == nullptr) return;
  const double cameras = NumberOr(*sights, "cameras");
  if (!(cameras > 0)) {
    section->html.Element(
        "p",
        "No camera stood still for ten photos: what stands behind the rotating part was not "
        "compared with the photos in which it is hidden.");
    section->numbers["sights"] = nullptr;
    return;
  }
  nlohmann::ordered_json numbers;
  for (const char* name : {"cameras", "photos", "other", "background", "alike", "never_free"}) {
    const double value = NumberOr(*sights, name);
    numbers[name] = std::isfinite(value) ? nlohmann::ordered_json(value) : nlohmann::ordered_json(nullptr);
  }
  section->numbers["sights"] = numbers;
  const auto percent = [&](const char* name) { return Significant(100 * NumberOr(*sights, name), 2) + " %"; };
  section->html.Element(
      "p",
      fmt::format("Of the pixels that the rotating part covers, {} show something else than what stands "
                  "behind it. {} look like a plain background: photos cannot tell whose they are. {} are "
                  "never free, so that the model alone says whose they are, and {} show the background.",
                  percent("other"), percent("alike"), percent("never_free"), percent("background")));
}

// Whose a plain table is: nothing in the photos tells it.
void WriteTable(const ReportInput& input, ReportSection* section) {
  if (input.IsOneBody()) return;
  const nlohmann::json* table = nullptr;
  for (const nlohmann::json& line : input.log) {
    if (line.is_object() && line.value("event", nlohmann::json()) == "table") table = &line;
  }
  if (table == nullptr) return;
  nlohmann::ordered_json numbers = {{"found", table->value("found", nlohmann::json()) == true}};
  if (numbers["found"] != true) {
    section->numbers["table"] = numbers;
    section->html.Element(
        "p",
        "No table's top that ends in a circle about the axis was found. A plain one, if there is any, looks "
        "the same whether it turns or stands still: the model alone says whose it is in the masks.");
    return;
  }
  for (const char* name : {"radius", "height", "share_of_directions", "false_alarms", "static_share"}) {
    const double value = NumberOr(*table, name);
    numbers[name] = std::isfinite(value) ? nlohmann::ordered_json(value) : nlohmann::ordered_json(nullptr);
  }
  const bool is_undecided = table->value("undecided", nlohmann::json()) == true;
  const bool is_object = table->value("counts_as", nlohmann::json()) == "object";
  numbers["undecided"] = is_undecided;
  numbers["counts_as"] = is_object ? "object" : "background";
  section->numbers["table"] = numbers;
  const std::string rim = fmt::format(
      "The table's top ends in a circle about the axis, of radius {}, in {} % of the directions. ",
      Significant(NumberOr(*table, "radius"), 3),
      Significant(100 * NumberOr(*table, "share_of_directions"), 2));
  const std::string verdict =
      is_undecided
          ? fmt::format(
                "Parts of it are so plain that photos do not tell whether they turn ({} % of its top or "
                "side seem to stand still); in the masks they count as {} (--plain_table).",
                Significant(100 * NumberOr(*table, "static_share"), 2),
                is_object ? "the object's" : "background")
          : std::string("The photos tell that it turns.");
  section->html.Element("p", rim + verdict);
}

}  // namespace

ReportSection PicturesSection(const ReportInput& input, Reporter& reporter) {
  ReportSection section{"pictures", "Split and model against the photos", {}, {}};
  section.numbers = nlohmann::ordered_json::object();
  WriteOverlays(input, reporter, &section);
  WriteComparison(input, reporter, &section);
  WriteSights(input, &section);
  WriteTable(input, &section);
  return section;
}

}  // namespace s2gs
