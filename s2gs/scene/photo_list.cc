#include "s2gs/scene/photo_list.h"

#include <cctype>
#include <cstdint>
#include <sstream>

#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"

namespace s2gs {
namespace {

constexpr uint64_t kMaxListBytes = uint64_t{1} << 26;

}  // namespace

std::set<std::string> ReadPhotoList(const std::filesystem::path& path, const std::vector<ScenePhoto>& photos,
                                    const std::string& option) {
  std::set<std::string> known;
  for (const ScenePhoto& photo : photos) known.insert(photo.name);
  std::set<std::string> names;
  std::istringstream lines(ReadWholeFile(path, kMaxListBytes, "Check " + option));
  std::string line;
  while (std::getline(lines, line)) {
    while (!line.empty() && std::isspace(static_cast<unsigned char>(line.back())) != 0) line.pop_back();
    if (line.empty()) continue;
    if (known.count(line) == 0) {
      throw UserError(path, "names " + line + ", which is no image of the scene",
                      "Give names as in sparse/0, one a line");
    }
    names.insert(line);
  }
  return names;
}

std::set<std::string> HeldOutNames(const TrainingSceneOptions& options,
                                   const std::vector<ScenePhoto>& photos) {
  std::set<std::string> names;
  if (options.test_every > 0) {
    for (size_t i = 0; i < photos.size(); i += options.test_every) names.insert(photos[i].name);
  }
  if (options.test_list.empty()) return names;
  names.merge(ReadPhotoList(options.test_list, photos, "--test_list"));
  return names;
}

}  // namespace s2gs
