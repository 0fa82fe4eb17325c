// EXIF of JPEG, PNG and of blocks on their own, the focal length that it gives, and the EXIF that is written
// of it.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <string>
#include <string_view>

#include "s2gs/image/exif.h"
#include "tests/fuzz/fuzz_seeds.h"

namespace {

std::string Bytes(uint32_t value, int count) {
  std::string text;
  for (int i = count - 1; i >= 0; --i)
    text += static_cast<char>((value >> (8U * static_cast<unsigned>(i))) & 0xFFU);
  return text;
}

void Require(bool holds) {
  if (!holds) std::abort();
}

}  // namespace

std::vector<std::string> FuzzSeeds() {
  s2gs::ExifTags tags;
  tags.focal_mm = 4.25;
  tags.focal_35mm_mm = 26;
  tags.digital_zoom = 1.5;
  tags.plane_px_per_mm = 800;
  tags.taken = {4032, 3024};
  tags.orientation = 6;
  const std::string exif = s2gs::MakeExif(tags);
  const auto length = static_cast<uint32_t>(exif.size());
  return {exif, "\xFF\xD8\xFF\xE1" + Bytes(length + 8, 2) + std::string("Exif\0\0", 6) + exif + "\xFF\xD9",
          "\x89PNG\r\n\x1A\n" + Bytes(length, 4) + "eXIf" + exif + Bytes(0, 4) + Bytes(0, 4) + "IEND"};
}

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  const std::string_view bytes(reinterpret_cast<const char*>(data), size);
  const std::optional<s2gs::ExifTags> tags = s2gs::ParseExif(bytes);
  if (!tags) return 0;
  Require(tags->orientation >= 1 && tags->orientation <= 8);
  for (const double value :
       {tags->focal_mm, tags->focal_35mm_mm, tags->digital_zoom, tags->plane_px_per_mm}) {
    Require(std::isfinite(value) && value >= 0);
  }
  for (const s2gs::ImageSize size_px : {s2gs::ImageSize{4000, 3000}, s2gs::ImageSize{1, 30000}}) {
    s2gs::IsCut(*tags, size_px);
    const std::optional<double> focal = s2gs::FocalPixels(*tags, size_px);
    Require(!focal || (std::isfinite(*focal) && *focal >= 0));
  }
  const std::optional<s2gs::ExifTags> again = s2gs::ParseExif(s2gs::MakeExif(*tags));
  Require(again && again->orientation == tags->orientation);
  // A focal length of no lens is cut off, not made another one.
  constexpr double kMostMm = 65535;
  Require(std::abs(again->focal_35mm_mm - std::min(tags->focal_35mm_mm, kMostMm)) <= 0.5);
  return 0;
}
