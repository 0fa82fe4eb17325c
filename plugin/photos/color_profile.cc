#include "plugin/photos/color_profile.h"

#include <lcms2.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <memory>
#include <vector>

namespace s2gs {
namespace {

struct ProfileCloser {
  void operator()(void* profile) const { cmsCloseProfile(profile); }
};
struct TransformDeleter {
  void operator()(void* transform) const { cmsDeleteTransform(transform); }
};
using Profile = std::unique_ptr<void, ProfileCloser>;
using Transform = std::unique_ptr<void, TransformDeleter>;

std::string NameOf(const Profile& profile) {
  std::array<char, 128> name{};
  cmsGetProfileInfoASCII(profile.get(), cmsInfoDescription, "en", "US", name.data(), name.size() - 1);
  std::string text = name.data();
  std::replace_if(
      text.begin(), text.end(), [](unsigned char c) { return c < 32 || c > 126; }, '?');
  return text;
}

}  // namespace

std::string ConvertToSrgb(std::string_view icc, Image8* image) {
  if (icc.empty()) return "";
  const Profile source(cmsOpenProfileFromMem(icc.data(), static_cast<cmsUInt32Number>(icc.size())));
  if (!source) return "its colour profile is damaged and was passed over";
  const std::string name = NameOf(source);
  if (name.find("sRGB") != std::string::npos) return "";
  const bool is_grey = cmsGetColorSpace(source.get()) == cmsSigGrayData;
  if (!is_grey && cmsGetColorSpace(source.get()) != cmsSigRgbData) return "";
  const Profile target(cmsCreate_sRGBProfile());
  const size_t count = static_cast<size_t>(image->width) * image->height;
  const Transform transform(cmsCreateTransform(source.get(), is_grey ? TYPE_GRAY_8 : TYPE_RGB_8, target.get(),
                                               TYPE_RGB_8, INTENT_RELATIVE_COLORIMETRIC,
                                               cmsFLAGS_BLACKPOINTCOMPENSATION));
  if (!transform) return "its colour profile \"" + name + "\" cannot be used and was passed over";
  std::vector<uint8_t> row(static_cast<size_t>(image->width) * 3);
  std::vector<uint8_t> converted(row.size());
  const size_t channels = static_cast<size_t>(image->channels);
  for (size_t begin = 0; begin < count; begin += static_cast<size_t>(image->width)) {
    const size_t in_channels = is_grey ? 1 : 3;
    for (size_t x = 0; x < static_cast<size_t>(image->width); ++x) {
      for (size_t c = 0; c < in_channels; ++c)
        row[x * in_channels + c] = image->pixels[(begin + x) * channels + c];
    }
    cmsDoTransform(transform.get(), row.data(), converted.data(), static_cast<cmsUInt32Number>(image->width));
    for (size_t x = 0; x < static_cast<size_t>(image->width); ++x) {
      for (size_t c = 0; c < 3; ++c) image->pixels[(begin + x) * channels + c] = converted[x * 3 + c];
    }
  }
  return "colours from \"" + name + "\" to sRGB";
}

std::string_view FindHeifProfile(std::string_view file) {
  constexpr size_t kHeaderBytes = 128;  // of a profile; its mark stands at 36 (ICC.1)
  constexpr size_t kMarkAt = 36;
  for (const std::string_view kind : {"colrprof", "colrrICC"}) {
    for (size_t at = file.find(kind); at != std::string_view::npos; at = file.find(kind, at + 1)) {
      if (at < 4) continue;
      uint64_t box = 0;  // its length, which stands before it and counts itself and both names
      for (size_t i = 0; i < 4; ++i) box = (box << 8U) | static_cast<uint8_t>(file[at - 4 + i]);
      const size_t begin = at + kind.size();
      if (box < 12 + kHeaderBytes || box - 12 > file.size() - begin) continue;
      const std::string_view icc = file.substr(begin, box - 12);
      if (icc.substr(kMarkAt, 4) == "acsp") return icc;
    }
  }
  return {};
}

}  // namespace s2gs
