#pragma once

#include <filesystem>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

namespace s2gs {

/// One run of `colmap mapper` on one body.
struct MappingAttempt {
  std::string settings;  ///< what was relaxed; "default".
  int models = 0;
  int images = 0;  ///< of the largest model.
  double seconds = 0;
};

/// The content of attempts.json, beside the models that they left.
nlohmann::json ToJson(const std::vector<MappingAttempt>& attempts);

/// Reads attempts.json. Throws UserError when it is missing or damaged: counts and seconds that are negative
/// or no numbers, anything that lacks.
std::vector<MappingAttempt> ReadMappingAttempts(const std::filesystem::path& path);

/// The same from a text; `path` is for messages.
std::vector<MappingAttempt> ParseMappingAttempts(const std::string& text, const std::filesystem::path& path);

}  // namespace s2gs
