#include "plugin/batch/batch_page.h"

#include <fmt/format.h>

#include <array>
#include <nlohmann/json.hpp>
#include <system_error>

#include "plugin/report/data_uri.h"
#include "plugin/report/html_writer.h"
#include "plugin/report/page_head.h"
#include "plugin/report/report_input.h"
#include "plugin/stage/json_file.h"
#include "s2gs/image/exif.h"
#include "s2gs/image/photo_folder.h"
#include "s2gs/image/photos.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

constexpr int kStripSide = 480;  // of a rendering's four panels beside each other [px]
constexpr int kPhotoSide = 120;  // [px]
constexpr int kQuality = 75;
// comparison.jpg of every scan with four photos or more has as many rows.
constexpr int kOverviewRows = 4;

std::string Picture(const BatchObject& object) {
  const Workspace workspace{object.workspace};
  try {
    if (Exists(workspace.Overview())) {
      const Image8 rows = ReadImage(workspace.Overview(), 3);
      const int height = rows.height % kOverviewRows == 0 ? rows.height / kOverviewRows : rows.height;
      return JpegDataUri(Thumbnail(CutAndShrink(rows, {0, 0, rows.width, height}, 1), kStripSide), kQuality);
    }
    const PhotoFolder folder = InspectPhotoFolder(object.images);
    if (folder.photos.empty()) return "";
    const fs::path& photo = folder.photos.front().path;
    const Image8 small = Thumbnail(ReadImage(photo, 3), kPhotoSide);
    return JpegDataUri(TurnUpright(small, ReadOrientation(photo)), kQuality);
  } catch (const UserError&) {
    return "";  // its own scan says what is wrong with it
  }
}

std::string NameOf(const BatchObject& object) {
  const std::string name = object.workspace.lexically_normal().filename().string();
  return !name.empty()                        ? name
         : object.workspace.has_parent_path() ? object.workspace.parent_path().filename().string()
                                              : fmt::format("line {}", object.line);
}

// RFC 3986: what is no letter, digit or "-_.~/" as %XX.
std::string UrlPath(const fs::path& path) {
  std::string url;
  for (const char c : path.generic_string()) {
    const bool is_plain = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') ||
                          c == '-' || c == '_' || c == '.' || c == '~' || c == '/';
    url += is_plain ? std::string(1, c) : fmt::format("%{:02X}", static_cast<unsigned char>(c));
  }
  return url;
}

// From the page to a file; empty where the file is not there.
std::string LinkTo(const fs::path& folder, const fs::path& file) {
  std::error_code ec;
  if (!fs::exists(file, ec)) return "";
  const fs::path relative = fs::relative(file, folder, ec);
  return ec || relative.empty() ? "" : UrlPath(relative);
}

// Of the page's style.
const char* StyleOf(BatchState state) {
  switch (state) {
    case BatchState::kDone:
      return "good";
    case BatchState::kDoubtful:
      return "doubtful";
    case BatchState::kFailed:
    case BatchState::kWrong:
      return "failed";
    case BatchState::kWaiting:
    case BatchState::kRunning:
      break;
  }
  return "unknown";
}

std::string Duration(double seconds) {
  return seconds < 120 ? Significant(seconds, 2) + " s" : Significant(seconds / 60, 2) + " min";
}

void WriteEntry(const fs::path& folder, const BatchEntry& entry, HtmlWriter* out) {
  const Workspace workspace{entry.object.workspace};
  const std::string link = entry.object.workspace.empty() ? "" : LinkTo(folder, workspace.ReportHtml());
  const auto linked = [&](std::string_view tag, auto write) {
    if (link.empty()) {
      out->Open(tag);
    } else {
      out->Open("a", {{"href", link}});
    }
    write();
    out->Close();
  };
  out->Open("tr", {{"class", StyleOf(entry.outcome.state)}});
  out->Open("td");
  if (!entry.picture.empty()) {
    linked("span", [&] { out->Void("img", {{"src", entry.picture}, {"alt", ""}}); });
  }
  out->Close();
  out->Open("td");
  linked("span", [&] { out->Text(NameOf(entry.object)); });
  out->Element("p", fmt::format("line {}", entry.object.line), {{"class", "note"}});
  out->Close();
  out->Open("td").Element("b", BatchStateName(entry.outcome.state), {{"class", "grade"}}).Close();
  for (const std::string& cell : {entry.outcome.why, entry.photos, entry.triangles,
                                  entry.record ? Duration(entry.record->wall_seconds) : std::string()}) {
    out->Element("td", cell);
  }
  out->Close();
}

std::string Page(const fs::path& folder, const std::string& title, const std::vector<BatchEntry>& entries) {
  HtmlWriter out;
  OpenPage(title, "Scans of many objects", &out);
  out.Close();
  out.Open("main").Open("section");
  out.Element("p", CountEntries(entries), {{"class", "sentence"}});
  out.Open("div", {{"class", "scroll"}}).Open("table", {{"class", "wide"}});
  WriteRow({"", "Object", "State", "Why", "Photos with a pose", "Triangles", "Last run"}, &out, "th");
  for (const BatchEntry& entry : entries) WriteEntry(folder, entry, &out);
  out.Close().Close();
  out.Close().Close();
  out.Close().Close();
  return out.html();
}

std::string Text(const nlohmann::json& object, const char* key) {
  const auto found = object.find(key);
  return found != object.end() && found->is_string() ? found->get<std::string>() : "";
}

}  // namespace

BatchEntry MakeBatchEntry(const BatchObject& object) {
  BatchEntry entry;
  entry.object = object;
  if (!object.fault.empty()) {
    entry.outcome = {BatchState::kWrong, object.fault};
    return entry;
  }
  const Workspace workspace{object.workspace};
  entry.outcome = LookAtObject(workspace);
  entry.record = ReadBatchRecord(workspace);
  entry.picture = Picture(object);
  const nlohmann::json mapper = ReadJsonFile(workspace.TurntableMapper());
  const double placed = NumberOr(mapper, "registered");
  if (placed >= 0) entry.photos = fmt::format("{} of {}", placed, NumberOr(mapper, "images"));
  const nlohmann::json report = ReadJsonFile(workspace.ReportJson());
  if (report.is_object() && report.contains("figures") && report["figures"].is_object()) {
    entry.triangles = Text(report["figures"], "triangles of the mesh");
  }
  return entry;
}

std::string CountEntries(const std::vector<BatchEntry>& entries) {
  constexpr std::array kOrder = {BatchState::kDone,  BatchState::kDoubtful, BatchState::kFailed,
                                 BatchState::kWrong, BatchState::kRunning,  BatchState::kWaiting};
  std::string text = Count(entries.size(), "object");
  bool is_first = true;
  for (const BatchState state : kOrder) {
    size_t count = 0;
    for (const BatchEntry& entry : entries) count += entry.outcome.state == state ? 1 : 0;
    if (count == 0) continue;
    text += fmt::format("{}{} {}", is_first ? ": " : ", ", count, BatchStateName(state));
    is_first = false;
  }
  return text;
}

void RequireNoOtherPage(const fs::path& folder) {
  const fs::path record = folder / "batch.json";
  const nlohmann::json json = ReadJsonFile(record);
  if (json.is_object() && json.contains("objects")) return;
  for (const fs::path& path : {folder / "index.html", record}) {
    std::error_code ec;
    if (!fs::exists(fs::symlink_status(path, ec))) continue;
    throw UserError(path, "is there already and was not written by scan_batch",
                    "Move it away, or give another --output_path");
  }
}

void WriteBatchPage(const fs::path& folder, const std::string& title,
                    const std::vector<BatchEntry>& entries) {
  CreateFolder(folder);
  nlohmann::ordered_json json = {{"version", 1}, {"objects", nlohmann::ordered_json::array()}};
  for (const BatchEntry& entry : entries) {
    nlohmann::ordered_json object = {{"line", entry.object.line},
                                     {"images", entry.object.images.string()},
                                     {"workspace", entry.object.workspace.string()},
                                     {"options", entry.object.options},
                                     {"state", BatchStateName(entry.outcome.state)},
                                     {"why", entry.outcome.why}};
    if (entry.record) {
      object["exit_code"] = entry.record->exit_code;
      object["finished"] = entry.record->finished;
      object["wall_seconds"] = entry.record->wall_seconds;
      object["cpu_seconds"] = entry.record->cpu_seconds;
    }
    json["objects"].push_back(std::move(object));
  }
  const std::string page = Page(folder, title, entries);
  const std::string text = json.dump(1, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n";
  WriteFilesTogether({{folder / "index.html", [&](std::ostream& out) { out << page; }},
                      {folder / "batch.json", [&](std::ostream& out) { out << text; }}});
}

}  // namespace s2gs
