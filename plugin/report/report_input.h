#pragma once

#include <filesystem>
#include <functional>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "plugin/report/html_writer.h"
#include "plugin/stage/split_labels.h"
#include "plugin/stage/stage.h"
#include "plugin/stage/workspace.h"
#include "sfm_split/base/reporter.h"
#include "sfm_split/scene/io/colmap_model.h"
#include "sfm_split/scene/io/turntable_file.h"

namespace s2gs {

/// What a workspace holds that the report is about. What is missing or damaged is empty here.
struct ReportInput {
  Workspace workspace;
  std::filesystem::path image_path;  ///< the photos, or dense/0/images; empty when neither is there.
  std::vector<std::string> photos;   ///< names of all photos that anything knows of, sorted.
  std::optional<ColmapModel> object;
  std::optional<ColmapModel> background;
  std::optional<TurntableFile> turntable;
  std::optional<SplitLabels> split;
  nlohmann::json mapper;            ///< split/turntable_mapper.json; null when missing.
  std::vector<nlohmann::json> log;  ///< the objects of both logs in s2gs, in order.
  std::vector<StageStatus> stages;
  std::vector<std::string> problems;  ///< files that are there, but cannot be read, with the reason.

  /// By the turntable file, else by the split; -1 when neither knows.
  int StationOf(const std::string& photo) const;
  /// False where the turntable file knows one body alone, photographed from all around: all angles are 0.
  bool ShowsATurn() const;
  /// One body alone, as a turntable file says that is there.
  bool IsOneBody() const { return turntable && !ShowsATurn(); }
  /// Upwards in the world's frame: the table's axis, or, where nothing turns and the frame is SfM's own, the
  /// mean of the photos' own upward directions, should they agree by more than chance; z where nothing is
  /// known.
  Eigen::Vector3d Up() const;
  /// The unit of the scene's lengths: "m", or "units" of SfM.
  const char* LengthUnitName() const;
  const ColmapImage* ObjectImage(const std::string& photo) const;
  const ColmapImage* BackgroundImage(const std::string& photo) const;
  const TurntableImage* TableImage(const std::string& photo) const;

  // By name, into the models above.
  std::map<std::string, uint32_t> object_ids;
  std::map<std::string, uint32_t> background_ids;
  std::map<std::string, size_t> table_rows;
};

/// Reads what is there. Warns about files that are damaged.
/// \param image_path  the photos; empty: where the stages found them, else dense/0/images.
ReportInput ReadReportInput(const Workspace& workspace, const std::filesystem::path& image_path,
                            Reporter& reporter);

/// One part of the report: its numbers, for report.json, and how report.html shows them.
struct ReportSection {
  std::string id;     ///< the key in report.json and the place in the page.
  std::string title;  ///< empty: it has no heading of its own.
  nlohmann::ordered_json numbers = nlohmann::ordered_json::object();
  HtmlWriter html;
};

/// A value that JSON can hold: null for infinite ones and for what is no number.
nlohmann::ordered_json FiniteOrNull(double value);

/// The number under a key; NaN when there is none.
double NumberOr(const nlohmann::json& object, const std::string& key);

/// "1 photo", "2 photos".
std::string Count(size_t count, const std::string& what);

}  // namespace s2gs
