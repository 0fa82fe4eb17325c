#include "sfm_split/base/image_name.h"

#include <system_error>

#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/printable.h"
#include "sfm_split/base/resolved_path.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

constexpr size_t kMaxBytes = 1024;  // a quarter of Linux's PATH_MAX: the workspace's own path comes before it
constexpr size_t kMaxPartBytes = 240;  // file systems' 255 less ".geometric.bin"

}  // namespace

std::optional<std::string> ImageName::FindFault(std::string_view text) {
  if (text.empty()) return "is empty";
  if (text.size() > kMaxBytes) return "is longer than " + std::to_string(kMaxBytes) + " bytes";
  for (std::string_view rest = text; !rest.empty();) {
    const std::optional<Utf8Character> character = FirstCharacter(rest);
    if (!character) return "is not valid UTF-8";
    if (IsControl(character->code)) return "has a control character";
    if (character->code == U'\\') return "has a backslash";
    rest.remove_prefix(character->num_bytes);
  }
  if (text.front() == ' ' || text.back() == ' ') return "begins or ends with a space";
  if (text.front() == '/') return "is an absolute path, not one in the photos' folder";
  for (std::string_view rest = text;;) {
    const size_t slash = rest.find('/');
    const std::string_view part = rest.substr(0, slash);
    if (part == "..") return "leads out of the photos' folder";
    if (part.empty() || part == ".") return "is not written in its shortest form";
    if (part.size() > kMaxPartBytes) {
      return "has a part longer than " + std::to_string(kMaxPartBytes) + " bytes";
    }
    if (slash == std::string_view::npos) return std::nullopt;
    rest.remove_prefix(slash + 1);
  }
}

ImageName::ImageName(std::string text, const fs::path& source) : text_(std::move(text)) {
  if (const std::optional<std::string> fault = FindFault(text_)) {
    throw UserError(source, "the image name " + DescribeNameFault(text_, *fault),
                    "Rename the photo and make its features and poses again");
  }
}

std::string DescribeNameFault(std::string_view name, const std::string& fault) {
  constexpr size_t kMaxShown = 120;  // bytes of a name in a message
  std::string shown = Printable(name.substr(0, kMaxShown));
  for (const auto& [from, to] : {std::pair("\n", "\\n"), std::pair("\t", "\\t")}) {
    for (size_t at = shown.find(from); at != std::string::npos; at = shown.find(from))
      shown.replace(at, 1, to);
  }
  return "\"" + shown + (name.size() > kMaxShown ? "..." : "") + "\" " + fault;
}

ImageOutputs::ImageOutputs(const fs::path& root, const fs::path& photos,
                           const std::vector<std::string>& photo_names)
    : root_(root), resolved_root_(ResolvedPath(root)) {
  if (photos.empty()) return;
  const fs::path resolved = ResolvedPath(photos);
  for (const std::string& name : photo_names) {
    if (ImageName::FindFault(name)) continue;
    photos_.insert(resolved / name);
    // The photo may itself be a link.
    photos_.insert(ResolvedPath(resolved / name));
  }
  if (!IsWithin(resolved_root_, resolved)) resolved_photos_ = resolved;
}

fs::path ImageOutputs::Locate(const fs::path& folder, const ImageName& name,
                              const std::string& suffix) const {
  fs::path path = folder / (name.text() + suffix);
  const fs::path resolved = ResolvedPath(path);
  const fs::path resolved_place = ResolvedPath(path.parent_path()) / path.filename();
  if (!IsWithin(resolved, resolved_root_) || !IsWithin(resolved_place, resolved_root_)) {
    throw UserError(
        path, "leads to " + resolved.string() + ", outside " + root_.string() + ": nothing is written there",
        "Replace the symbolic link on the way by a folder");
  }
  const bool is_photo = photos_.count(resolved) > 0 || photos_.count(resolved_place) > 0;
  const bool is_among_photos = !resolved_photos_.empty() && (IsWithin(resolved, resolved_photos_) ||
                                                             IsWithin(resolved_place, resolved_photos_));
  if (is_photo || is_among_photos) {
    throw UserError(path,
                    is_photo ? "is a photo: it is not written over"
                             : "lies in the photos' folder, where nothing is written",
                    "Keep the photos in a folder of their own, such as images in the workspace");
  }
  return path;
}

fs::path ImageOutputs::Make(const fs::path& folder, const ImageName& name, const std::string& suffix) const {
  fs::path path = Locate(folder, name, suffix);
  CreateFolder(path.parent_path());
  return path;
}

}  // namespace s2gs
