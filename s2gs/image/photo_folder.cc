#include "s2gs/image/photo_folder.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <fstream>
#include <map>
#include <optional>
#include <set>
#include <string_view>
#include <system_error>

#include "s2gs/image/image_header.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/image_name.h"
#include "sfm_split/base/lower_case.h"
#include "sfm_split/base/parallel_for.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

constexpr size_t kMaxListed = 10;
constexpr int kMinSide = 8;  // fewer pixels than one feature covers
constexpr size_t kTailBytes =
    1 << 16;  // the end of a whole file lies within it, but for what some phones append
// A photo of more pixels than this has noise, and noise does not shrink to a hundredth of a byte a pixel; a
// picture of one colour does, and would take gigabytes when it is decoded.
constexpr int64_t kManyPixels = int64_t{1} << 26;
constexpr int64_t kMaxPixelsPerByte = 100;

constexpr std::array<std::string_view, 3> kPhotoExtensions = {".jpg", ".jpeg", ".png"};
constexpr std::array<std::string_view, 23> kRawExtensions = {
    ".dng", ".cr2", ".cr3", ".crw", ".nef", ".nrw", ".arw", ".sr2", ".raf", ".orf", ".rw2", ".rwl",
    ".pef", ".srw", ".erf", ".dcr", ".kdc", ".3fr", ".fff", ".iiq", ".mef", ".mrw", ".x3f"};
constexpr std::array<std::string_view, 20> kForeignExtensions = {
    ".tif", ".tiff", ".bmp", ".webp", ".heic", ".heif", ".avif", ".jxl", ".jp2", ".j2k",
    ".gif", ".ppm",  ".pgm", ".psd",  ".exr",  ".hdr",  ".tga",  ".dib", ".jpe", ".jfif"};

template <typename List>
bool Contains(const List& list, std::string_view word) {
  return std::find(list.begin(), list.end(), word) != list.end();
}

std::string HowToConvert(const std::string& extension) {
  if (extension == ".jpe" || extension == ".jfif") return "rename it to .jpg";
  if (extension == ".heic" || extension == ".heif") {
    return "convert it to JPEG or PNG: s2gs photo_importer, or heif-convert";
  }
  if (Contains(kRawExtensions, extension)) {
    return "develop it to JPEG or PNG: s2gs photo_importer, or darktable-cli";
  }
  return "convert it to JPEG or PNG: s2gs photo_importer, or mogrify -format png";
}

// Whether `mark` stands in the file at `begin` or after it; the end is looked at first.
bool HasMarkAfter(const fs::path& path, uint64_t begin, uint64_t num_bytes, std::string_view mark) {
  std::ifstream stream(path, std::ios::binary);
  std::string block(kTailBytes, '\0');
  const auto has = [&](uint64_t from, uint64_t count) {
    stream.clear();
    stream.seekg(static_cast<std::streamoff>(from));
    stream.read(block.data(), static_cast<std::streamsize>(count));
    const std::string_view read(block.data(), static_cast<size_t>(stream.gcount()));
    return read.find(mark) != std::string_view::npos;
  };
  const uint64_t tail = num_bytes - begin > kTailBytes ? num_bytes - kTailBytes : begin;
  if (has(tail, num_bytes - tail)) return true;
  // Blocks overlap so that no mark falls between two.
  for (uint64_t at = begin; at < tail; at += kTailBytes - mark.size()) {
    if (has(at, kTailBytes)) return true;
  }
  return false;
}

std::string FaultOf(PhotoFile* photo) {
  try {
    std::error_code ec;
    const fs::file_status status = fs::status(photo->path, ec);
    if (status.type() == fs::file_type::not_found) return "is a link that leads nowhere: remove or mend it";
    if (!fs::is_regular_file(status)) return "is no regular file: remove it";
    photo->num_bytes = fs::file_size(photo->path, ec);
    if (photo->num_bytes == 0) return "is empty: copy it again, or remove it";
    const ImageHeader header = ReadImageHeader(photo->path);
    photo->size = header.size;
    photo->is_png = !header.is_jpeg;
    photo->png = header.png;
    const int64_t pixels = int64_t{header.size.width} * header.size.height;
    const std::string size =
        std::to_string(header.size.width) + " x " + std::to_string(header.size.height) + " pixels";
    if (std::min(header.size.width, header.size.height) < kMinSide) {
      return "has " + size + ", too few to find anything in: remove it";
    }
    if (pixels > kManyPixels && pixels / kMaxPixelsPerByte > static_cast<int64_t>(photo->num_bytes)) {
      return "claims " + size + " in " + std::to_string(photo->num_bytes) +
             " bytes, which no photo fits into: remove it, or copy it again";
    }
    const std::string_view end =
        header.is_jpeg ? std::string_view("\xFF\xD9", 2) : std::string_view("IEND", 4);
    if (!HasMarkAfter(photo->path, header.num_bytes, photo->num_bytes, end)) {
      return "ends before its pixels do: copy it again, or remove it";
    }
  } catch (const UserError& error) {
    std::string problem = error.what();
    const std::string path = photo->path.string() + ": ";
    if (problem.compare(0, path.size(), path) == 0) problem.erase(0, path.size());
    return problem;
  }
  return "";
}

struct Listing {
  std::vector<fs::path> photos;
  std::vector<fs::path> foreign;
  std::vector<fs::path> linked_folders;
  size_t num_hidden_photos = 0;
  bool has_other_files = false;
};

Listing List(const fs::path& folder) {
  Listing listing;
  std::error_code ec;
  fs::recursive_directory_iterator entry(folder, ec);
  for (const fs::recursive_directory_iterator end; !ec && entry != end; entry.increment(ec)) {
    const std::string file = entry->path().filename().string();
    const std::string extension = LowerCase(entry->path().extension().string());
    std::error_code type_ec;
    const bool is_folder = entry->is_directory(type_ec);
    const bool is_hidden = file[0] == '.';
    if (is_hidden && is_folder) entry.disable_recursion_pending();
    if (is_folder) {
      listing.has_other_files = listing.has_other_files || is_hidden;
      if (!is_hidden && entry->is_symlink(type_ec)) listing.linked_folders.push_back(entry->path());
    } else if (is_hidden || !(Contains(kPhotoExtensions, extension))) {
      listing.has_other_files = true;
      if (is_hidden && Contains(kPhotoExtensions, extension)) ++listing.num_hidden_photos;
      if (!is_hidden && (Contains(kForeignExtensions, extension) || Contains(kRawExtensions, extension)))
        listing.foreign.push_back(entry->path());
    } else {
      listing.photos.push_back(entry->path());
    }
  }
  if (ec) throw UserError(folder, "cannot be listed (" + ec.message() + ")", "Check --image_path");
  std::sort(listing.photos.begin(), listing.photos.end());
  std::sort(listing.foreign.begin(), listing.foreign.end());
  std::sort(listing.linked_folders.begin(), listing.linked_folders.end());
  return listing;
}

std::string NameOf(const fs::path& path, const fs::path& folder) {
  return path.lexically_relative(folder).generic_string();
}

// Links may lead around in circles, and what is behind one has two names: they are not followed.
void AddFaultsOfLinks(const Listing& listing, const fs::path& folder, std::vector<std::string>* faults) {
  for (const fs::path& path : listing.linked_folders) {
    const std::string name = NameOf(path, folder);
    faults->push_back(
        (ImageName::FindFault(name) ? DescribeNameFault(name, "") : name + ": ") +
        "is a link to a folder, whose photos are not found through it: give that folder itself, "
        "or replace the link by a copy or a bind mount of its photos");
  }
}

std::string StemOf(const std::string& name) { return LowerCase(name.substr(0, name.find_last_of('.'))); }

}  // namespace

PhotoFolder InspectPhotoFolder(const fs::path& folder, ForeignPhotos foreign) {
  const Listing listing = List(folder);
  PhotoFolder result;
  result.has_other_files = listing.has_other_files;
  std::vector<std::string> problems(listing.photos.size());
  result.photos.resize(listing.photos.size());
  ParallelFor(static_cast<int64_t>(listing.photos.size()), 0, [&](int64_t i) {
    result.photos[i].path = listing.photos[i];
    problems[i] = FaultOf(&result.photos[i]);
  });
  std::set<std::string> stems;
  std::map<std::string, std::string> by_lower_case;
  for (size_t i = 0; i < result.photos.size(); ++i) {
    PhotoFile& photo = result.photos[i];
    photo.name = NameOf(photo.path, folder);
    if (const std::optional<std::string> fault = ImageName::FindFault(photo.name)) {
      result.faults.push_back("the name " + DescribeNameFault(photo.name, *fault) + ": rename the file");
      continue;
    }
    if (!problems[i].empty()) result.faults.push_back(photo.name + ": " + problems[i]);
    stems.insert(StemOf(photo.name));
    const auto [other, is_new] = by_lower_case.emplace(LowerCase(photo.name), photo.name);
    if (!is_new) {
      result.faults.push_back(
          photo.name + ": differs from " + other->second +
          " in case alone, and their masks would replace each other on many disks: rename one");
    }
  }
  size_t num_twins = 0;
  for (const fs::path& path : listing.foreign) {
    const std::string name = NameOf(path, folder);
    if (stems.count(StemOf(name)) > 0) {
      ++num_twins;
      continue;
    }
    const std::string extension = LowerCase(path.extension().string());
    const std::optional<std::string> fault = ImageName::FindFault(name);
    if (foreign == ForeignPhotos::kListed && !fault) {
      PhotoFile& photo = result.foreign.emplace_back();
      photo.name = name;
      photo.path = path;
      continue;
    }
    result.faults.push_back((fault ? DescribeNameFault(name, "") : name + ": ") +
                            "is neither JPEG nor PNG, which photos must be: " + HowToConvert(extension) +
                            ", or take it out of the folder");
  }
  AddFaultsOfLinks(listing, folder, &result.faults);
  if (listing.num_hidden_photos > 0) {
    result.notes.push_back(std::to_string(listing.num_hidden_photos) +
                           " hidden files (their names begin with a point) are left alone");
  }
  if (num_twins > 0) {
    result.notes.push_back(std::to_string(num_twins) +
                           " files of other formats are left alone: a photo of the same "
                           "name stands beside each");
  }
  return result;
}

std::string ListFaults(const std::string& heading, const std::vector<std::string>& faults) {
  std::string list = heading + ":";
  for (size_t i = 0; i < std::min(faults.size(), kMaxListed); ++i) list += "\n  " + faults[i];
  if (faults.size() > kMaxListed) list += "\n  and " + std::to_string(faults.size() - kMaxListed) + " more";
  return list;
}

fs::path FindMask(const fs::path& folder, const std::string& image_name) {
  std::error_code ec;
  const std::string stem = (folder / image_name).replace_extension().string();
  for (const std::string& path :
       {(folder / image_name).string() + ".png", (folder / image_name).string() + ".mask.png", stem + ".png",
        stem + ".mask.png"}) {
    if (fs::exists(path, ec)) return path;
  }
  const auto of_former = [&](const auto& extensions) -> fs::path {
    for (const std::string_view extension : extensions) {
      std::string upper(extension);
      std::transform(upper.begin(), upper.end(), upper.begin(),
                     [](unsigned char c) { return static_cast<char>(std::toupper(c)); });
      for (const std::string& former : {std::string(extension), upper}) {
        for (const char* suffix : {".png", ".mask.png"}) {
          std::string path = stem;
          path.append(former).append(suffix);
          if (fs::exists(path, ec)) return path;
        }
      }
    }
    return {};
  };
  const fs::path path = of_former(kForeignExtensions);
  return path.empty() ? of_former(kRawExtensions) : path;
}

}  // namespace s2gs
