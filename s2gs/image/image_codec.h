#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <string_view>

#include "s2gs/image/image_file.h"
#include "s2gs/image/image_header.h"
#include "sfm_split/base/byte_reader.h"

namespace s2gs {

/// One file format each for s2gs/image/image_file.h; see there for what is accepted and thrown.

Image8 DecodeJpeg(std::string_view bytes, const std::filesystem::path& path, int channels);
Image8 DecodePng(std::string_view bytes, const std::filesystem::path& path, int channels);
/// The alpha channel alone; nothing when the file has none.
std::optional<Image8> DecodePngAlpha(std::string_view bytes, const std::filesystem::path& path);

/// The reader stands at the file's first byte.
ImageSize ReadJpegSize(ByteReader& reader);
/// \param pixels  what the header says of the pixels; may be null.
ImageSize ReadPngSize(ByteReader& reader, PngPixels* pixels = nullptr);

std::string EncodeJpeg(const Image8& image, const std::filesystem::path& path, int quality);
/// \param exif  what the eXIf chunk holds; empty: there is none.
std::string EncodePng(const Image8& image, const std::filesystem::path& path, std::string_view exif = {});

/// Throws UserError unless the size is positive and within the bounds of image_file.h.
void CheckImageSize(uint64_t width, uint64_t height, const std::filesystem::path& path);

/// A file of the right kind whose content cannot be decoded.
[[noreturn]] void ThrowDamagedImage(const std::filesystem::path& path, const std::string& problem);

}  // namespace s2gs
