#include "plugin/stage/split_labels.h"

#include <Eigen/LU>
#include <nlohmann/json.hpp>
#include <vector>

#include "sfm_split/base/error.h"
#include "sfm_split/base/image_name.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

// An image's labels as the split made them, beside its "labels".
constexpr const char* kSplitLabels = "split_labels";
constexpr const char* kRemedy = "Run `s2gs motion_splitter` again";

[[noreturn]] void ThrowDamaged(const fs::path& path, const nlohmann::json::exception& error) {
  throw UserError(path, std::string("is damaged: ") + error.what(), kRemedy);
}

// Deeper than any split writes it; to write it again takes stack for each level.
constexpr int kMaxDepth = 64;

nlohmann::json Parse(const std::string& text, const fs::path& path) {
  const auto check_depth = [&](int depth, nlohmann::json::parse_event_t, const nlohmann::json&) {
    if (depth > kMaxDepth) throw UserError(path, "is damaged: nested too deeply", kRemedy);
    return true;
  };
  return nlohmann::json::parse(text, check_depth);
}

CaptureCase CaseOf(const std::string& name, const fs::path& path) {
  for (const CaptureCase capture_case :
       {CaptureCase::kTurntable, CaptureCase::kSingleStation, CaptureCase::kOneBody}) {
    if (name == CaptureCaseName(capture_case)) return capture_case;
  }
  throw UserError(path, "has an unknown case \"" + name + "\"", kRemedy);
}

// A map of the picture that a turn of the camera may be: no pixel goes to infinity. Splits of before have
// none.
Eigen::Matrix3d ReadShake(const nlohmann::json& image, const std::string& name, const fs::path& path) {
  if (!image.contains("photo_from_first")) return Eigen::Matrix3d::Identity();
  const auto rows = image.at("photo_from_first").get<std::vector<double>>();
  if (rows.size() == 9) {
    Eigen::Matrix3d H = Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(rows.data());
    if (H.allFinite() && H.determinant() > 0) return H;
  }
  throw UserError(path, "gives image " + name + " a shake that cannot be", kRemedy);
}

// The images' entries by name.
std::map<std::string, SplitLabels::Image> ReadImageLabels(const nlohmann::json& file, const fs::path& path) {
  const nlohmann::json& images = file.at("images");
  std::map<std::string, SplitLabels::Image> of_name;
  for (const nlohmann::json& image : images) {
    const std::string name = image.at("name").get<std::string>();
    if (const std::optional<std::string> fault = ImageName::FindFault(name)) {
      throw UserError(path, "the image name " + DescribeNameFault(name, *fault), kRemedy);
    }
    const nlohmann::json& station = image.at("station");
    // Each station has an image, so that there are no more of them.
    if (!station.is_number_integer() || station < 0 || station >= images.size()) {
      throw UserError(path, "gives image " + name + " a station that cannot be", kRemedy);
    }
    // What an earlier mapping made of the labels does not count: it would not come out the same again.
    const char* const labels = image.contains(kSplitLabels) ? kSplitLabels : "labels";
    const SplitLabels::Image entry{station.get<int>(), image.at(labels).get<std::string>(),
                                   image.value("represents_station", false), ReadShake(image, name, path),
                                   static_cast<int>(of_name.size())};
    if (!of_name.emplace(name, entry).second) throw UserError(path, "has image " + name + " twice", kRemedy);
  }
  return of_name;
}

}  // namespace

SplitLabels ParseSplitLabels(const std::string& text, const fs::path& path) {
  SplitLabels result;
  try {
    const nlohmann::json file = Parse(text, path);
    result.capture_case = CaseOf(file.value("case", "turntable"), path);
    result.reason = file.value("reason", "");
    result.images = ReadImageLabels(file, path);
  } catch (const nlohmann::json::exception& error) {
    ThrowDamaged(path, error);
  }
  return result;
}

std::string ReplaceSplitLabels(const std::string& text, const std::map<std::string, std::string>& labels,
                               const fs::path& path) {
  try {
    nlohmann::json file = Parse(text, path);
    for (nlohmann::json& image : file.at("images")) {
      const auto found = labels.find(image.at("name").get<std::string>());
      if (found == labels.end()) continue;
      if (!image.contains(kSplitLabels)) image[kSplitLabels] = image.at("labels");
      image["labels"] = found->second;
    }
    return file.dump(1) + '\n';
  } catch (const nlohmann::json::exception& error) {
    ThrowDamaged(path, error);
  }
}

}  // namespace s2gs
