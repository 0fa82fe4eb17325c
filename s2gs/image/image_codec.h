#pragma once

#include <filesystem>
#include <string>
#include <string_view>

#include "s2gs/image/image_file.h"
#include "sfm_split/base/byte_reader.h"

namespace s2gs {

/// One file format each for s2gs/image/image_file.h; see there for what is accepted and thrown.

Image8 DecodeJpeg(std::string_view bytes, const std::filesystem::path& path, int channels);
Image8 DecodePng(std::string_view bytes, const std::filesystem::path& path, int channels);

/// The reader stands at the file's first byte.
ImageSize ReadJpegSize(ByteReader& reader);
ImageSize ReadPngSize(ByteReader& reader);

std::string EncodeJpeg(const Image8& image, const std::filesystem::path& path, int quality);
std::string EncodePng(const Image8& image, const std::filesystem::path& path);

/// Throws UserError unless the size is positive and within the bounds of image_file.h.
void CheckImageSize(uint64_t width, uint64_t height, const std::filesystem::path& path);

/// A file of the right kind whose content cannot be decoded.
[[noreturn]] void ThrowDamagedImage(const std::filesystem::path& path, const std::string& problem);

}  // namespace s2gs
