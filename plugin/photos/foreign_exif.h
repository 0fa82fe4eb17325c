#pragma once

#include <OpenImageIO/imageio.h>

#include <optional>
#include <string_view>

#include "s2gs/image/exif.h"

namespace s2gs {

/// EXIF by OpenImageIO's names, where its reader knows the format's. A number that no lens has (negative, not
/// finite) counts as not given.
ExifTags TagsOf(const OIIO::ImageSpec& spec);

/// The block of EXIF wherever the bytes of a HEIC or AVIF (`is_heif`) or of a WebP file keep it; nothing when
/// there is none.
std::optional<ExifTags> FindExif(std::string_view bytes, bool is_heif);

}  // namespace s2gs
