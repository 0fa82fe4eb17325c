#pragma once

#include <cstddef>
#include <string>
#include <string_view>

#include "s2gs/image/image_file.h"

namespace s2gs {

/// RFC 4648, with padding.
std::string Base64(std::string_view bytes);

/// "data:image/jpeg;base64,...": a picture inside the page.
/// \param quality  1 to 100.
std::string JpegDataUri(const Image8& image, int quality);
/// The same with less quality, down to half of what is asked, where it has more than `most_bytes`.
std::string JpegDataUri(const Image8& image, int quality, size_t most_bytes);

/// The same without loss, for diagrams.
std::string PngDataUri(const Image8& image);

/// The image no larger than `longer_side` [px] on either side, by area; smaller ones as they are.
Image8 Thumbnail(const Image8& image, int longer_side);

}  // namespace s2gs
