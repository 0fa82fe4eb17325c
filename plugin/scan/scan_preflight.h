#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "plugin/cli/command.h"
#include "plugin/photos/photo_import.h"
#include "plugin/stage/workspace.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

/// A scan as far as it can be checked before any of its work.
struct ScanRequest {
  Workspace workspace;
  std::filesystem::path image_path;  ///< the photos as they came: a folder or, when is_video, a file.
  std::optional<ImportPlan> import;  ///< when they have to be imported.
  bool is_video = false;
  std::filesystem::path ffmpeg_path;  ///< empty: searched for on PATH.
  std::filesystem::path mask_path;    ///< empty: none.
  std::filesystem::path angles_path;  ///< empty: none.
  std::filesystem::path colmap_path;  ///< empty: searched for on PATH.
  std::string use_gpu = "auto";
  int test_every = 0;
  std::optional<int64_t> num_iterations;
  std::optional<int32_t> max_image_size;
  int max_num_features = 8192;
  /// Photos in which places are stated, with the option that states them.
  std::vector<std::pair<std::string, std::string>> marked_photos;
  bool trains = true;    ///< not with --until split.
  bool meshes = true;    ///< only with --until mesh.
  bool textures = true;  ///< the same, and with --texture 1.
  /// The commands that make up the scan, with their arguments.
  std::vector<std::pair<std::string, std::vector<std::string>>> steps;
};

/// What was found.
struct ScanCheck {
  std::vector<std::string> option_faults;  ///< of the command line.
  std::vector<std::string> faults;         ///< of files, folders, the machine.
  std::vector<std::string> warnings;
  std::vector<std::string> notes;
};

/// Looks at everything that a scan needs and that is known before it begins: the options of all its commands,
/// the photos' names, formats and headers, masks, stated angles, folders, space on the disk and in memory,
/// the GPU asked for, colmap and its version. Reads headers only and changes nothing. Throws UserError when
/// the photos' folder cannot be listed.
ScanCheck CheckScan(const ScanRequest& request, Reporter& reporter);

/// Throws when there are faults, all of them in one message: CommandLineError when the options alone are
/// wrong, else UserError. Warnings and notes go to the reporter.
void RequireSoundScan(const ScanRequest& request, Reporter& reporter);

}  // namespace s2gs
