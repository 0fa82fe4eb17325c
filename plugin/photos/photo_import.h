#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "plugin/stage/workspace.h"
#include "s2gs/image/photo_folder.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

/// One photo of an import.
struct PhotoToImport {
  PhotoFile file;             ///< as it came; its size is that of the stored pixels.
  std::string name;           ///< in the imported set: the same but for the extension.
  bool is_foreign = false;    ///< neither JPEG nor PNG: OpenImageIO reads it.
  bool is_mirrored = false;   ///< by EXIF, as far as the header tells.
  bool is_converted = false;  ///< else copied as it is.
};

/// What has to be done to a folder of photos before COLMAP and we can read all of it.
struct ImportPlan {
  std::vector<PhotoToImport> photos;  ///< by name.
  std::vector<std::string> faults;    ///< one for each file that has to be mended.
  std::vector<std::string> notes;
  bool is_needed = false;  ///< else the photos can be used where they are.
};

/// Looks at names and headers. Converted are: formats other than JPEG and PNG, PNG of 16 bits, and photos
/// that EXIF mirrors, for a mirrored scene is another one. Throws UserError when the folder cannot be listed.
ImportPlan PlanImport(const std::filesystem::path& folder);

/// Copies or converts the photos into the workspace's folder of imported photos, each atomically. What an
/// earlier run that was stopped has written of the same files is kept; what earlier runs imported and is no
/// longer wanted is removed. Converted photos are PNG of 8 bits with the EXIF tags of ExifTags, pixels as
/// stored; those with alpha keep it. Throws UserError when the plan has faults, with all files that turn out
/// damaged at once, and when the folder has files that s2gs did not put there.
void ImportPhotos(const ImportPlan& plan, const Workspace& workspace, Reporter& reporter);

}  // namespace s2gs
