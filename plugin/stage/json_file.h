#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>

namespace s2gs {

/// A JSON file of a workspace; null when it is missing, unreadable or no JSON.
nlohmann::json ReadJsonFile(const std::filesystem::path& path);

}  // namespace s2gs
