#include "plugin/colmap/mapping_attempts.h"

#include <cmath>
#include <cstdint>
#include <limits>
#include <nlohmann/json.hpp>

#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"

namespace s2gs {
namespace {

using nlohmann::json;

constexpr uint64_t kMaxBytes = uint64_t{1} << 24;
constexpr const char* kRemedy = "Delete it and run turntable_mapper again";

int CountOf(const json& attempt, const char* key, const std::filesystem::path& path) {
  const json& value = attempt.at(key);
  if (!value.is_number_integer() || value < 0 || value > std::numeric_limits<int>::max()) {
    throw UserError(path, std::string("is damaged: ") + key + " is no count", kRemedy);
  }
  return value.get<int>();
}

}  // namespace

json ToJson(const std::vector<MappingAttempt>& attempts) {
  json result = json::array();
  for (const MappingAttempt& attempt : attempts) {
    result.push_back({{"settings", attempt.settings},
                      {"models", attempt.models},
                      {"images", attempt.images},
                      {"seconds", attempt.seconds}});
  }
  return result;
}

std::vector<MappingAttempt> ReadMappingAttempts(const std::filesystem::path& path) {
  return ParseMappingAttempts(ReadWholeFile(path, kMaxBytes, kRemedy), path);
}

std::vector<MappingAttempt> ParseMappingAttempts(const std::string& text, const std::filesystem::path& path) {
  std::vector<MappingAttempt> attempts;
  try {
    const json content = json::parse(text);
    if (!content.is_array()) throw UserError(path, "is damaged: it is no list", kRemedy);
    for (const json& entry : content) {
      MappingAttempt attempt;
      attempt.settings = entry.at("settings").get<std::string>();
      attempt.models = CountOf(entry, "models", path);
      attempt.images = CountOf(entry, "images", path);
      attempt.seconds = entry.at("seconds").get<double>();
      if (!std::isfinite(attempt.seconds) || attempt.seconds < 0) {
        throw UserError(path, "is damaged: seconds is no duration", kRemedy);
      }
      attempts.push_back(attempt);
    }
  } catch (const json::exception& error) {
    throw UserError(path, std::string("is damaged: ") + error.what(), kRemedy);
  }
  return attempts;
}

}  // namespace s2gs
