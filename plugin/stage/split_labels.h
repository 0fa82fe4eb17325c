#pragma once

#include <Eigen/Core>
#include <filesystem>
#include <map>
#include <string>

#include "sfm_split/scene/features.h"

namespace s2gs {

/// The content of split/labels.json.
struct SplitLabels {
  struct Image {
    int station = 0;
    std::string labels;               ///< one character a keypoint.
    bool represents_station = false;  ///< its background stands for the station's.
    /// Where the photo shows a background pixel of its station's first photo [px].
    Eigen::Matrix3d photo_from_first = Eigen::Matrix3d::Identity();
    int place = 0;  ///< in the file, whose images stand in the order of capture.
  };
  CaptureCase capture_case = CaptureCase::kTurntable;
  std::string reason;                   ///< of the case, in the split's words; may be empty.
  std::map<std::string, Image> images;  ///< by name.
};

/// Labels are those of the split, whatever ReplaceSplitLabels made of them since. Throws UserError, which
/// names `path`, when the text is no such file; what the labels' characters say is not checked.
SplitLabels ParseSplitLabels(const std::string& text, const std::filesystem::path& path);

/// The same file with other labels of the images that are named, those of the split beside them, and the rest
/// as it was. Throws as ParseSplitLabels().
std::string ReplaceSplitLabels(const std::string& text, const std::map<std::string, std::string>& labels,
                               const std::filesystem::path& path);

}  // namespace s2gs
