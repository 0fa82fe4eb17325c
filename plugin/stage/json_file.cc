#include "plugin/stage/json_file.h"

#include <cstdint>
#include <utility>

#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"

namespace s2gs {
namespace {

constexpr uint64_t kMaxJsonBytes = uint64_t{1} << 30;

}  // namespace

nlohmann::json ReadJsonFile(const std::filesystem::path& path) {
  if (!Exists(path)) return nullptr;
  try {
    nlohmann::json json = nlohmann::json::parse(ReadWholeFile(path, kMaxJsonBytes), nullptr, false);
    return json.is_discarded() ? nlohmann::json(nullptr) : json;
  } catch (const UserError&) {
    return nullptr;
  }
}

}  // namespace s2gs
