#include "plugin/photos/video_frames.h"

#include <algorithm>
#include <charconv>
#include <string_view>
#include <system_error>
#include <utility>

#include "plugin/colmap/child_process.h"
#include "plugin/colmap/find_executable.h"
#include "plugin/photos/imported_folder.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

constexpr char kInstallRemedy[] =
    "Install ffmpeg (on Debian: apt install ffmpeg), or name its executable with --ffmpeg_path";
constexpr size_t kMinFrames = 3;
constexpr char kSharpnessMark[] = "lavfi.signalstats.YAVG=";

// Runs ffmpeg; what it says last is the reason should it fail.
void Run(const fs::path& ffmpeg, std::vector<std::string> arguments, const fs::path& video,
         const std::function<void(std::string_view)>& on_line, Reporter& reporter) {
  ChildCommand command;
  command.arguments = {ffmpeg.string(), "-hide_banner", "-nostdin", "-nostats", "-loglevel", "error", "-y"};
  command.arguments.insert(command.arguments.end(), std::make_move_iterator(arguments.begin()),
                           std::make_move_iterator(arguments.end()));
  std::string last;
  const ChildExit exit = RunChild(
      command, StopGrace{},
      [&](const ChildOutput& output) {
        if (!output.is_complete) return;
        on_line(output.line);
        // Values of frames stand on lines of their own kind.
        const bool is_value = output.line.substr(0, 6) == "frame:" || output.line.substr(0, 6) == "lavfi.";
        if (!is_value && !output.line.empty()) last = std::string(output.line);
      },
      [&] { return reporter.StopRequested(); });
  if (exit.Succeeded()) return;
  std::replace_if(
      last.begin(), last.end(), [](unsigned char c) { return c < 32 || c == 127; }, ' ');
  throw UserError(video, "cannot be read by ffmpeg" + (last.empty() ? "" : " (" + last + ")"),
                  "Check that it is a whole video file, or give a folder of photos");
}

// ffmpeg's pattern of numbered files in a folder, in whose own name '%' is no pattern.
std::string PatternIn(const fs::path& folder) {
  std::string pattern = "file:";
  for (const char c : folder.string()) pattern += c == '%' ? "%%" : std::string(1, c);
  return pattern + "/%06d.png";
}

// ffmpeg's expression for these frames, as a balanced tree: it refuses sums of more than 100 terms in a row.
std::string SelectionOf(const size_t* frames, size_t count) {
  if (count == 1) return "eq(n," + std::to_string(*frames) + ")";
  const size_t half = count / 2;
  return "(" + SelectionOf(frames, half) + "+" + SelectionOf(frames + half, count - half) + ")";
}

std::string InputOf(const fs::path& video) { return "file:" + video.string(); }

// "000012.png"; longer where six digits do not do.
std::string NumberedName(size_t number) {
  constexpr size_t kDigits = 6;
  std::string digits = std::to_string(number);
  digits.insert(0, kDigits - std::min(kDigits, digits.size()), '0');
  return digits + ".png";
}

}  // namespace

fs::path FindFfmpeg(const fs::path& ffmpeg_path) {
  return FindExecutable("ffmpeg", ffmpeg_path, ", and reads videos", kInstallRemedy);
}

std::vector<size_t> SharpestOfIntervals(const std::vector<double>& sharpness, size_t num_frames) {
  const size_t count = std::min(num_frames, sharpness.size());
  std::vector<size_t> frames;
  frames.reserve(count);
  for (size_t i = 0; i < count; ++i) {
    const auto begin = static_cast<std::ptrdiff_t>(i * sharpness.size() / count);
    const auto end = static_cast<std::ptrdiff_t>((i + 1) * sharpness.size() / count);
    const auto best = std::max_element(sharpness.begin() + begin, sharpness.begin() + end);
    frames.push_back(static_cast<size_t>(best - sharpness.begin()));
  }
  return frames;
}

std::vector<double> MeasureSharpness(const fs::path& ffmpeg, const fs::path& video, Reporter& reporter) {
  std::vector<double> sharpness;
  const std::string filter =
      "format=gray,convolution=0m='0 -1 0 -1 4 -1 0 -1 0',signalstats,"
      "metadata=mode=print:key=lavfi.signalstats.YAVG:file='pipe\\:1'";
  Run(
      ffmpeg, {"-i", InputOf(video), "-map", "0:v:0", "-vf", filter, "-f", "null", "-"}, video,
      [&](std::string_view line) {
        const size_t at = line.find(kSharpnessMark);
        if (at == std::string_view::npos) return;
        line.remove_prefix(at + sizeof(kSharpnessMark) - 1);
        double value = 0;
        std::from_chars(line.data(), line.data() + line.size(), value);
        sharpness.push_back(value);
        constexpr size_t kReportEvery = 64;
        if (sharpness.size() % kReportEvery == 0) {
          reporter.Progress("look at the video", static_cast<int64_t>(sharpness.size()), 0);
        }
      },
      reporter);
  return sharpness;
}

void ImportVideo(const fs::path& ffmpeg, const fs::path& video, int num_frames, const Workspace& workspace,
                 Reporter& reporter) {
  const std::vector<double> sharpness = MeasureSharpness(ffmpeg, video, reporter);
  if (sharpness.size() < kMinFrames) {
    throw UserError(video, "has " + std::to_string(sharpness.size()) + " frames",
                    "Give a longer video, or photos");
  }
  const std::vector<size_t> frames = SharpestOfIntervals(sharpness, static_cast<size_t>(num_frames));
  ImportedFolder folder(workspace, "video");
  std::vector<std::string> names;
  names.reserve(frames.size());
  for (const size_t frame : frames) names.push_back("frame_" + NumberedName(frame));
  folder.Expect(names);
  // Under other names until all are there: ffmpeg counts from 1 and writes them one after another.
  const fs::path scratch = workspace.Own() / "frames";
  std::error_code ec;
  fs::remove_all(scratch, ec);
  CreateFolder(scratch);
  const auto remove_scratch = [&] { fs::remove_all(scratch, ec); };
  try {
    Run(
        ffmpeg,
        {"-i", InputOf(video), "-map", "0:v:0", "-vf",
         "select='" + SelectionOf(frames.data(), frames.size()) + "'", "-vsync", "passthrough", "-pix_fmt",
         "rgb24", "-compression_level", "2", "-f", "image2", PatternIn(scratch)},
        video, [](std::string_view /*line*/) {}, reporter);
    for (size_t i = 0; i < names.size(); ++i) {
      const fs::path from = scratch / NumberedName(i + 1);
      if (!Exists(from)) {
        throw UserError(video, "ffmpeg read fewer frames the second time",
                        "Copy the video again, or give photos");
      }
      fs::rename(from, folder.Make(names[i]));
    }
  } catch (...) {
    remove_scratch();
    throw;
  }
  remove_scratch();
  reporter.Info(std::to_string(frames.size()) + " of " + std::to_string(sharpness.size()) +
                " frames of the video, the sharpest of each interval: " + workspace.Imported().string());
}

}  // namespace s2gs
