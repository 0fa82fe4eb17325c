#include "plugin/photos/foreign_photo.h"
#include "sfm_split/base/error.h"

namespace s2gs {
namespace {

constexpr char kReason[] = "this program was built without OpenImageIO and Little CMS";

[[noreturn]] void Refuse(const std::filesystem::path& path) {
  throw UserError(
      path, std::string("cannot be converted: ") + kReason,
      "Convert it to JPEG or PNG, or build s2gs with them (Debian: libopenimageio-dev, liblcms2-dev)");
}

}  // namespace

std::optional<std::string> WhyNoForeignPhotos() { return kReason; }
ImageSize ReadForeignSize(const std::filesystem::path& path) { Refuse(path); }
ForeignPhoto ReadForeignPhoto(const std::filesystem::path& path) { Refuse(path); }

}  // namespace s2gs
