#include "plugin/colmap/body_mapper.h"

#include <algorithm>
#include <array>
#include <map>
#include <optional>
#include <system_error>
#include <utility>

#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/stopwatch.h"
#include "sfm_split/scene/io/colmap_database.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

struct Relaxation {
  const char* name;
  std::vector<ColmapOption> options;
};

// COLMAP's defaults, then what small and weakly textured objects need.
const std::array<Relaxation, 3>& Relaxations() {
  static const std::array<Relaxation, 3> all = {{
      {"default", {}},
      {"relaxed",
       {{"Mapper.min_num_matches", "10"},
        {"Mapper.init_min_num_inliers", "40"},
        {"Mapper.init_min_tri_angle", "8"},
        {"Mapper.abs_pose_min_num_inliers", "15"},
        {"Mapper.abs_pose_min_inlier_ratio", "0.15"}}},
      {"most tolerant",
       {{"Mapper.min_num_matches", "8"},
        {"Mapper.init_min_num_inliers", "20"},
        {"Mapper.init_min_tri_angle", "4"},
        {"Mapper.init_max_reg_trials", "4"},
        {"Mapper.abs_pose_min_num_inliers", "10"},
        {"Mapper.abs_pose_min_inlier_ratio", "0.1"},
        {"Mapper.filter_min_tri_angle", "0.8"}}},
  }};
  return all;
}

std::vector<ColmapOption> GivenOptions(const std::vector<std::string>& given) {
  std::vector<ColmapOption> options;
  options.reserve(given.size());
  for (const std::string& text : given) {
    const size_t equals = text.find('=');
    if (equals == std::string::npos || equals == 0) {
      throw UserError("--mapper_options: \"" + text +
                      "\" is no NAME=VALUE, like Mapper.ba_refine_focal_length=0");
    }
    const std::string name = text.substr(0, equals);
    options.push_back(
        {name.find('.') == std::string::npos ? "Mapper." + name : name, text.substr(equals + 1)});
  }
  return options;
}

// Later options win over earlier ones of the same name.
std::vector<ColmapOption> Combine(const std::vector<std::vector<ColmapOption>>& groups) {
  std::map<std::string, ColmapOption> by_name;
  for (const std::vector<ColmapOption>& group : groups) {
    for (const ColmapOption& option : group) by_name[option.name] = option;
  }
  std::vector<ColmapOption> result;
  result.reserve(by_name.size());
  for (const auto& [name, option] : by_name) result.push_back(option);
  return result;
}

fs::path TrialFolder(const fs::path& output) { return output.string() + ".trial"; }
fs::path TrialDatabase(const fs::path& output) { return output.string() + ".trial.db"; }

void RemoveTrial(const fs::path& output) {
  std::error_code ec;
  fs::remove_all(TrialFolder(output), ec);
  for (const char* suffix : {"", "-wal", "-shm"}) fs::remove(TrialDatabase(output).string() + suffix, ec);
}

}  // namespace

BodyMapping ObjectMapping() {
  BodyMapping mapping;
  mapping.body = "the object";
  mapping.min_model_size = 3;
  mapping.enough_share = 0.5;
  return mapping;
}

BodyMapping BackgroundMapping() {
  BodyMapping mapping;
  mapping.body = "the background";
  mapping.min_model_size = 2;
  mapping.enough_share = 0.9;
  return mapping;
}

std::vector<MappingAttempt> MapBody(const BodyMapping& mapping, ColmapProgram* colmap, Reporter& reporter) {
  const std::vector<ColmapOption> given = GivenOptions(mapping.options);
  std::vector<MappingAttempt> attempts;
  int best = 0;
  std::optional<ColmapKilled> killed;
  std::error_code ec;
  fs::remove_all(mapping.output, ec);
  CreateFolder(mapping.output);
  const fs::path trial = TrialFolder(mapping.output);
  // COLMAP opens databases for writing and leaves traces: it gets a copy.
  const fs::path database = TrialDatabase(mapping.output);
  ColmapDatabase::SafeCopy(mapping.database, database, reporter);
  for (const Relaxation& relaxation : Relaxations()) {
    if (static_cast<int>(attempts.size()) == mapping.max_attempts) break;
    const double start = SteadySeconds();
    fs::remove_all(trial, ec);
    CreateFolder(trial);
    MappingAttempt attempt;
    attempt.settings = relaxation.name;
    try {
      colmap->Run({"mapper",
                   Combine({{{"database_path", database.string()},
                             {"image_path", mapping.images.string()},
                             {"output_path", trial.string()},
                             {"Mapper.extract_colors", "0"},
                             // With several threads models differ from run to run; time they hardly save.
                             {"Mapper.num_threads", "1"},
                             {"Mapper.min_model_size", std::to_string(mapping.min_model_size)}},
                            relaxation.options,
                            given}),
                   {{trial / "0"}}},
                  reporter);
    } catch (const ColmapKilled& error) {
      reporter.Warn(error.what());
      killed = error;
    } catch (const UserError& error) {
      // A body that cannot be mapped is a finding, not a fault.
      reporter.Debug(error.what());
    }
    const std::vector<ColmapModel> models = ReadMappedModels(trial, reporter);
    attempt.models = static_cast<int>(models.size());
    attempt.images = models.empty() ? 0 : static_cast<int>(models[0].images.size());
    attempt.seconds = SteadySeconds() - start;
    if (attempt.images > best) {
      best = attempt.images;
      fs::remove_all(mapping.output, ec);
      fs::rename(trial, mapping.output);
    }
    attempts.push_back(attempt);
    if (attempt.images >= mapping.enough_share * mapping.num_images) break;
    if (static_cast<int>(attempts.size()) < mapping.max_attempts) {
      reporter.Info("colmap mapper (" + attempt.settings + ") registered " + std::to_string(attempt.images) +
                    " of " + std::to_string(mapping.num_images) + " images of " + mapping.body +
                    ": trying more tolerant settings");
    }
  }
  RemoveTrial(mapping.output);
  if (best == 0 && killed) throw ColmapKilled(*killed);
  return attempts;
}

void RemoveMapping(const fs::path& output) {
  std::error_code ec;
  fs::remove_all(output, ec);
  RemoveTrial(output);
}

std::vector<ColmapModel> ReadMappedModels(const fs::path& folder, Reporter& reporter) {
  std::vector<fs::path> paths;
  std::error_code ec;
  for (fs::directory_iterator entry(folder, ec), end; !ec && entry != end; entry.increment(ec)) {
    if (entry->is_directory(ec)) paths.push_back(entry->path());
  }
  std::sort(paths.begin(), paths.end());
  std::vector<ColmapModel> models;
  for (const fs::path& path : paths) {
    try {
      models.push_back(ReadColmapModel(path));
    } catch (const UserError& error) {
      reporter.Warn(error.what());
    }
  }
  std::stable_sort(models.begin(), models.end(), [](const ColmapModel& a, const ColmapModel& b) {
    return a.images.size() > b.images.size();
  });
  return models;
}

}  // namespace s2gs
