#include "plugin/photos/photo_import.h"

#include <algorithm>
#include <atomic>
#include <fstream>
#include <map>
#include <optional>
#include <system_error>
#include <utility>

#include "plugin/photos/foreign_photo.h"
#include "plugin/photos/imported_folder.h"
#include "s2gs/image/exif.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/lower_case.h"
#include "sfm_split/base/machine_share.h"
#include "sfm_split/base/parallel_for.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

constexpr int kOpaqueBits = 8;
// While a photo is converted: four channels of floats at worst, what becomes of them, and the encoder's copy.
constexpr uint64_t kBytesPerPixel = 4 * 4 + 4 + 4;

std::string WithExtension(const std::string& name, const std::string& extension) {
  return name.substr(0, name.find_last_of('.')) + extension;
}

// The message without the path that stands before it.
std::string WithoutPath(const UserError& error, const fs::path& path) {
  std::string text = error.what();
  const std::string prefix = path.string() + ": ";
  if (text.compare(0, prefix.size(), prefix) == 0) text.erase(0, prefix.size());
  return text;
}

PhotoToImport PlanOwn(const PhotoFile& file) {
  PhotoToImport photo;
  photo.file = file;
  photo.name = file.name;
  if (file.size.width == 0) return photo;  // at fault, and perhaps a pipe
  const std::optional<ExifTags> tags = ReadExif(file.path);
  photo.is_mirrored = tags && IsMirrored(tags->orientation);
  photo.is_foreign = file.is_png && file.png.bits > kOpaqueBits;
  photo.is_converted = photo.is_foreign || photo.is_mirrored;
  if (photo.is_converted) photo.name = WithExtension(file.name, ".png");
  return photo;
}

// JPEGs under other names need no more than a name that COLMAP takes for one.
PhotoToImport PlanForeign(const PhotoFile& file) {
  PhotoToImport photo;
  photo.file = file;
  std::error_code ec;
  photo.file.num_bytes = fs::file_size(file.path, ec);
  const std::string extension = LowerCaseExtension(file.path);
  if (extension == ".jpe" || extension == ".jfif") {
    photo.name = WithExtension(file.name, ".jpg");
    photo.file.size = ReadImageSize(file.path);
    const std::optional<ExifTags> tags = ReadExif(file.path);
    photo.is_mirrored = tags && IsMirrored(tags->orientation);
    photo.is_converted = photo.is_mirrored;
    if (photo.is_converted) photo.name = WithExtension(file.name, ".png");
    return photo;
  }
  photo.name = WithExtension(file.name, ".png");
  photo.is_foreign = true;
  photo.is_converted = true;
  photo.file.size = ReadForeignSize(file.path);
  return photo;
}

void Convert(const PhotoToImport& photo, const fs::path& path, std::string* color) {
  Image8 image;
  ExifTags tags;
  if (photo.is_foreign) {
    ForeignPhoto foreign = ReadForeignPhoto(photo.file.path);
    image = std::move(foreign.image);
    tags = foreign.tags;
    *color = foreign.color;
  } else {
    image = ReadImage(photo.file.path, 3);
    if (const std::optional<ExifTags> read = ReadExif(photo.file.path)) tags = *read;
  }
  if (IsMirrored(tags.orientation)) {
    image = MirrorRows(image);
    tags.orientation = OrientationOfMirrored(tags.orientation);
  }
  WritePng(path, image, MakeExif(tags));
}

// So many photos as the cores take and as fit into memory at once.
int NumThreads(const ImportPlan& plan) {
  int64_t largest = 1;
  for (const PhotoToImport& photo : plan.photos) {
    if (photo.is_converted)
      largest = std::max(largest, int64_t{photo.file.size.width} * photo.file.size.height);
  }
  return ThreadsThatFit(kBytesPerPixel * static_cast<uint64_t>(largest));
}

void Copy(const fs::path& from, const fs::path& to) {
  std::ifstream source = OpenForReading(from);
  WriteFileAtomically(to, [&](std::ostream& target) { target << source.rdbuf(); });
}

}  // namespace

ImportPlan PlanImport(const fs::path& folder) {
  const PhotoFolder inspected = InspectPhotoFolder(folder, ForeignPhotos::kListed);
  ImportPlan plan;
  plan.faults = inspected.faults;
  plan.notes = inspected.notes;
  const size_t num_own = inspected.photos.size();
  std::vector<PhotoToImport> all(num_own + inspected.foreign.size());
  std::vector<std::string> problems(all.size());
  ParallelFor(static_cast<int64_t>(all.size()), 0, [&](int64_t i) {
    const auto at = static_cast<size_t>(i);
    const PhotoFile& file = at < num_own ? inspected.photos[at] : inspected.foreign[at - num_own];
    try {
      all[at] = at < num_own ? PlanOwn(file) : PlanForeign(file);
    } catch (const UserError& error) {
      problems[at] = file.name + ": " + WithoutPath(error, file.path);
    }
  });
  std::map<std::string, std::string> source_of;
  for (size_t i = 0; i < all.size(); ++i) {
    if (!problems[i].empty()) {
      plan.faults.push_back(problems[i]);
      continue;
    }
    const auto [other, is_new] = source_of.emplace(LowerCase(all[i].name), all[i].file.name);
    // Own photos that differ in case alone are named already.
    if (!is_new && (all[i].is_converted || all[i].is_foreign)) {
      plan.faults.push_back(all[i].file.name + ": would be imported under the same name as " + other->second +
                            ": take one of them out of the folder, or rename it");
      continue;
    }
    plan.is_needed = plan.is_needed || all[i].name != all[i].file.name || all[i].is_converted;
    plan.photos.push_back(std::move(all[i]));
  }
  // That something has to be imported is known even where it cannot be.
  plan.is_needed = plan.is_needed || !inspected.foreign.empty();
  std::sort(plan.photos.begin(), plan.photos.end(),
            [](const PhotoToImport& a, const PhotoToImport& b) { return a.name < b.name; });
  return plan;
}

void ImportPhotos(const ImportPlan& plan, const Workspace& workspace, Reporter& reporter) {
  if (!plan.faults.empty()) throw UserError(ListFaults("these photos cannot be imported", plan.faults));
  ImportedFolder folder(workspace, "photos");
  std::vector<std::string> names;
  names.reserve(plan.photos.size());
  for (const PhotoToImport& photo : plan.photos) names.push_back(photo.name);
  folder.Expect(names);

  const auto total = static_cast<int64_t>(plan.photos.size());
  std::vector<std::string> problems(plan.photos.size());
  std::vector<std::string> colors(plan.photos.size());
  std::atomic<int64_t> num_kept = 0;
  // In parts, so that progress and Ctrl-C come from this thread: a raw file takes seconds.
  const int num_threads = NumThreads(plan);
  for (int64_t first = 0; first < total; first += num_threads) {
    if (reporter.StopRequested()) throw Interrupted();
    reporter.Progress("import photos", first, total);
    ParallelFor(std::min<int64_t>(num_threads, total - first), num_threads, [&](int64_t of_part) {
      const auto i = static_cast<size_t>(first + of_part);
      const PhotoToImport& photo = plan.photos[i];
      if (folder.IsDone(photo.name, photo.file.path)) {
        ++num_kept;
        return;
      }
      try {
        const fs::path path = folder.Make(photo.name);
        if (photo.is_converted) {
          Convert(photo, path, &colors[i]);
        } else {
          Copy(photo.file.path, path);
        }
        folder.Done(photo.name, photo.file.path);
      } catch (const UserError& error) {
        problems[i] = photo.file.name + ": " + WithoutPath(error, photo.file.path);
      }
    });
  }
  reporter.Progress("import photos", total, total);
  problems.erase(std::remove(problems.begin(), problems.end(), ""), problems.end());
  if (!problems.empty()) throw UserError(ListFaults("these photos cannot be imported", problems));
  std::map<std::string, int> num_by_color;
  for (const std::string& color : colors) {
    if (!color.empty()) ++num_by_color[color];
  }
  for (const auto& [color, num] : num_by_color) reporter.Info(std::to_string(num) + " photos: " + color);
  const auto num_converted = std::count_if(plan.photos.begin(), plan.photos.end(),
                                           [](const PhotoToImport& photo) { return photo.is_converted; });
  reporter.Info(std::to_string(num_converted) + " photos converted, " +
                std::to_string(total - num_converted) + " copied" +
                (num_kept > 0 ? ", " + std::to_string(num_kept) + " of them by an earlier run" : "") + ": " +
                workspace.Imported().string());
}

}  // namespace s2gs
