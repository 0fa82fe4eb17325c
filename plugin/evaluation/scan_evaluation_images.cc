#include <algorithm>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <system_error>
#include <tuple>
#include <utility>
#include <vector>

#include "plugin/evaluation/scan_evaluation.h"
#include "s2gs/image/image_error.h"
#include "s2gs/image/image_file.h"
#include "sfm_split/base/lower_case.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

std::vector<std::pair<std::string, double>> MeanAndMin(const std::vector<double>& values) {
  const Summary summary = Summarize(values);
  return {{"mean", summary.mean}, {"median", summary.median}, {"min", summary.min}};
}

// The first of `candidates` that exists, or nothing.
fs::path FirstExisting(const std::vector<fs::path>& candidates) {
  std::error_code ec;
  for (const fs::path& path : candidates) {
    if (fs::is_regular_file(path, ec)) return path;
  }
  return {};
}

bool IsImageFile(const fs::path& path) {
  const std::string extension = LowerCaseExtension(path);
  return extension == ".png" || extension == ".jpg" || extension == ".jpeg";
}

// "sub/a.jpg" -> "sub/a"
std::string WithoutExtension(const fs::path& path) { return (path.parent_path() / path.stem()).string(); }

// The images below a folder by their path without extension.
std::map<std::string, fs::path> ListImages(const fs::path& folder) {
  std::error_code ec;
  if (!fs::is_directory(folder, ec)) throw UserError(folder, "no such folder", "Check the path");
  std::map<std::string, fs::path> images;
  for (const fs::directory_entry& entry : fs::recursive_directory_iterator(folder)) {
    if (!entry.is_regular_file(ec) || !IsImageFile(entry.path())) continue;
    const std::string key = WithoutExtension(entry.path().lexically_relative(folder));
    if (!images.emplace(key, entry.path()).second) {
      throw UserError(folder, "has two images named " + key + " with different extensions", "Remove one");
    }
  }
  return images;
}

// Photos, and masks or labels, of the data set by the photo's name without extension.
struct TruthFiles {
  std::map<std::string, fs::path> photos;
  std::map<std::string, fs::path> labels;
};

TruthFiles ListTruth(const SceneTruth& truth) {
  TruthFiles files;
  for (const SceneTruthImage& image : truth.images) {
    const std::string key = fs::path(image.name).stem().string();
    files.photos[key] = truth.folder / image.file;
    if (!image.mask.empty()) files.labels[key] = truth.folder / image.mask;
  }
  return files;
}

PixelMask RotatingPixels(const Image8& labels, uint8_t static_label) {
  PixelMask mask{labels.width, labels.height, std::vector<uint8_t>(labels.pixels.size())};
  std::transform(labels.pixels.begin(), labels.pixels.end(), mask.inside.begin(),
                 [&](uint8_t label) { return static_cast<uint8_t>(label != static_label); });
  return mask;
}

void Step(Reporter& reporter, const char* task, size_t done, size_t total) {
  reporter.Progress(task, static_cast<int64_t>(done), static_cast<int64_t>(total));
  if (reporter.StopRequested()) throw Interrupted();
}

std::string CountOf(size_t count, size_t total) {
  return std::to_string(count) + " of " + std::to_string(total);
}

// The mask of a rendered image, at its size: a file, or the truth's label; nothing where there is none.
// \param key  the image's name without extension.
std::optional<PixelMask> MaskOfPair(const ImagePaths& paths, const SceneTruth* truth,
                                    const TruthFiles& truth_files, const std::string& key,
                                    const fs::path& photo, const Image8& image, Reporter& reporter) {
  PixelMask mask;
  const std::string photo_name = paths.reference.empty() ? photo.filename().string()
                                                         : photo.lexically_relative(paths.reference).string();
  const auto label = truth_files.labels.find(key);
  try {
    if (!paths.masks.empty()) {
      const fs::path mask_path =
          FirstExisting({paths.masks / (photo_name + ".png"), paths.masks / (key + ".png")});
      if (mask_path.empty()) return std::nullopt;
      mask = MaskFromImage(ReadImage(mask_path, 1));
    } else if (label != truth_files.labels.end()) {
      mask = RotatingPixels(ReadImage(label->second, 1), truth->static_label);
    } else {
      return std::nullopt;
    }
  } catch (const UserError& error) {
    reporter.Warn(error.what());
    return std::nullopt;
  }
  if (mask.width != image.width || mask.height != image.height) {
    mask = ResizeNearest(mask, image.width, image.height);
  }
  return mask;
}

// Rendering and photo of a pair. Throws UserError when one cannot be read or their sizes differ.
std::pair<Image8, Image8> ReadPair(const fs::path& rendered, const fs::path& photo) {
  std::pair<Image8, Image8> pair = {ReadImage(rendered, 3), ReadImage(photo, 3)};
  if (pair.first.width != pair.second.width || pair.first.height != pair.second.height) {
    throw UserError(rendered, "is not of the size of " + photo.string(), "Render at the photo's size");
  }
  return pair;
}

}  // namespace

void EvaluateMasks(const Workspace& workspace, const SceneTruth& truth, Reporter& reporter,
                   Figures* figures) {
  Figure rotating{
      "mask_iou", "", "intersection over union of the masks with everything that rotates", {}, ""};
  Figure object{
      "object_iou", "", "the same with the object alone, pixels of the disc left out on both sides", {}, ""};
  Figure images{"mask_images", "images", "train images with a mask that can be read", {}, ""};
  std::vector<const SceneTruthImage*> train;
  for (const SceneTruthImage& image : truth.images) {
    if (image.is_train && !image.mask.empty()) train.push_back(&image);
  }
  std::vector<double> rotating_ious;
  std::vector<double> object_ious;
  std::string problem = "no masks";
  if (train.empty()) problem = "the ground truth has no masks";
  for (size_t i = 0; i < train.size(); ++i) {
    Step(reporter, "compare masks", i, train.size());
    const std::string& name = train[i]->name;
    const fs::path path =
        FirstExisting({workspace.Mask(name), workspace.Mask(fs::path(name).stem().string())});
    if (path.empty()) continue;
    PixelMask mask;
    try {
      mask = MaskFromImage(ReadImage(path, 1));
    } catch (const UserError& error) {
      reporter.Warn(error.what());
      problem = error.what();
      continue;
    }
    const MaskOverlap overlap = CompareMask(mask, ReadImage(truth.folder / train[i]->mask, 1),
                                            truth.object_label, truth.disc_label, truth.static_label);
    rotating_ious.push_back(overlap.rotating_iou);
    object_ious.push_back(overlap.object_iou);
  }
  if (!train.empty()) Step(reporter, "compare masks", train.size(), train.size());
  if (rotating_ious.empty()) {
    rotating.missing = object.missing = images.missing = problem;
  } else {
    rotating.values = MeanAndMin(rotating_ious);
    object.values = MeanAndMin(object_ious);
    images.values = {{"value", static_cast<double>(rotating_ious.size())},
                     {"of", static_cast<double>(train.size())}};
  }
  for (Figure* figure : {&rotating, &object, &images}) figures->push_back(std::move(*figure));
}

void EvaluateImages(const ImagePaths& paths, const SceneTruth* truth, Reporter& reporter, Figures* figures) {
  Figure psnr{"psnr_db", "dB", "peak signal-to-noise ratio over the whole image", {}, ""};
  Figure ssim{
      "ssim",
      "",
      "SSIM over the whole image, as in 3DGS and 2DGS: window 11, sigma 1.5, zero padding, biased variance, "
      "mean over channels",
      {},
      ""};
  Figure valid{"ssim_valid", "", "the same over the pixels whose window lies inside the image", {}, ""};
  Figure masked_psnr{"mask_psnr_db", "dB", "peak signal-to-noise ratio inside the mask", {}, ""};
  Figure masked_ssim{"mask_ssim", "", "mean of the SSIM map over the pixels of the mask", {}, ""};
  Figure count{"image_pairs", "images", "rendered images with a photo of the same name and size", {}, ""};
  Figure masked_count{"mask_image_pairs", "images", "of these, those with a mask", {}, ""};

  TruthFiles truth_files;
  if (truth != nullptr) truth_files = ListTruth(*truth);
  const std::map<std::string, fs::path> rendered = ListImages(paths.rendered);
  const std::map<std::string, fs::path> photos =
      paths.reference.empty() ? truth_files.photos : ListImages(paths.reference);
  std::vector<double> psnrs, ssims, valid_ssims, masked_psnrs, masked_ssims;
  std::string problem =
      rendered.empty() ? "no images in " + paths.rendered.string() : "no photos of these names";
  size_t num_pairs = 0;
  size_t num_masked = 0;
  size_t done = 0;
  for (const auto& [key, path] : rendered) {
    Step(reporter, "compare images", done++, rendered.size());
    const auto photo = photos.find(key);
    if (photo == photos.end()) continue;
    Image8 image, reference;
    try {
      std::tie(image, reference) = ReadPair(path, photo->second);
    } catch (const UserError& error) {
      reporter.Warn(error.what());
      problem = error.what();
      continue;
    }
    ++num_pairs;
    const SsimMap map = ComputeSsim(image, reference);
    psnrs.push_back(Psnr(image, reference));
    ssims.push_back(map.Mean());
    valid_ssims.push_back(map.MeanOfValid());

    const std::optional<PixelMask> mask =
        MaskOfPair(paths, truth, truth_files, key, photo->second, image, reporter);
    if (!mask || mask->Count() == 0) continue;
    ++num_masked;
    masked_psnrs.push_back(Psnr(image, reference, &*mask));
    masked_ssims.push_back(map.Mean(*mask));
  }
  if (!rendered.empty()) Step(reporter, "compare images", rendered.size(), rendered.size());
  if (num_pairs > 0) {
    psnr.values = MeanAndMin(psnrs);
    ssim.values = MeanAndMin(ssims);
    valid.values = MeanAndMin(valid_ssims);
    count.values = {{"value", static_cast<double>(num_pairs)}, {"of", static_cast<double>(rendered.size())}};
  }
  if (num_masked > 0) {
    masked_psnr.values = MeanAndMin(masked_psnrs);
    masked_ssim.values = MeanAndMin(masked_ssims);
    masked_count.values = {{"value", static_cast<double>(num_masked)},
                           {"of", static_cast<double>(num_pairs)}};
  }
  psnr.missing = ssim.missing = valid.missing = count.missing = problem;
  masked_psnr.missing = masked_ssim.missing = masked_count.missing =
      num_pairs > 0 ? "no masks with pixels inside, of " + CountOf(num_pairs, rendered.size()) + " images"
                    : problem;
  for (Figure* figure : {&psnr, &ssim, &valid, &masked_psnr, &masked_ssim, &count, &masked_count}) {
    figures->push_back(std::move(*figure));
  }
}

}  // namespace s2gs
