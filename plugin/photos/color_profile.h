#pragma once

#include <string>
#include <string_view>

#include "s2gs/image/image_file.h"

namespace s2gs {

/// Converts colours (3 or 4 channels) from an ICC profile to sRGB, and says from which; empty where there is
/// nothing to convert. Profiles that cannot be used are passed over, as by all programs that know none.
std::string ConvertToSrgb(std::string_view icc, Image8* image);

/// The ICC profile within the bytes of a HEIC or AVIF file: its first box `colr` that holds one (ISO/IEC
/// 14496-12, 12.1.5); empty when there is none. Never reads beyond the bytes.
std::string_view FindHeifProfile(std::string_view file);

}  // namespace s2gs
