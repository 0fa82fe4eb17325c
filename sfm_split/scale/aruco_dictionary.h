#pragma once

#include <opencv2/aruco.hpp>
#include <string>

namespace s2gs {

/// OpenCV's dictionary for a name of MarkerDictionaries(). Throws UserError for any other.
cv::Ptr<cv::aruco::Dictionary> ArucoDictionary(const std::string& name);

}  // namespace s2gs
