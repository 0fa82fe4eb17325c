// The JSON files of a scan as its summary and its report read them: the first byte of the input chooses the
// file.

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>
#include <vector>

#include "plugin/report/scan_report.h"
#include "plugin/report/scan_summary.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/reporter.h"
#include "tests/fuzz/fuzz_seeds.h"
#include "tests/fuzz/scratch_path.h"

namespace {

namespace fs = std::filesystem;

const s2gs::Workspace& Workspace() {
  static const s2gs::Workspace workspace{s2gs::ScratchPath("scan")};
  return workspace;
}

std::vector<fs::path> Files() {
  const s2gs::Workspace& w = Workspace();
  return {w.SplitLabels(), w.TurntableMapper(), w.ScanRecord(), w.Log(), w.ReportJson(),
          w.Plan(),        w.Turntable()};
}

std::string Content(const fs::path& path) {
  std::ifstream stream(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
}

// Of scripts and pictures with handlers, which no name from a file may add to.
size_t CountScripts(const std::string& page) {
  size_t count = 0;
  for (const char* mark : {"<script", "<img ", "onerror="}) {
    for (size_t at = page.find(mark); at != std::string::npos; at = page.find(mark, at + 1)) ++count;
  }
  return count;
}

}  // namespace

std::vector<std::string> FuzzSeeds() {
  return {
      std::string(1, '\0') +
          R"({"case":"turntable","reason":"r","images":[{"name":"a.jpg","station":0,"labels":"012"}]})",
      std::string(1, '\1') +
          R"({"version":1,"case":"turntable","path":"p","path_reason":"r","images":2,"registered":1,"missing":["b"],)"
          R"("seconds":{"read":1},"verdict":{"verdict":"good","reasons":["<script>"],"advice":["y"],"checks":[]},)"
          R"("stations":1,"object":{"points":1,"observations":2,"mean_reprojection_error_px":0.5},)"
          R"("sigma":{"angle_median_deg":0.1},"angle_sigma_deg":{"a.jpg":0.1},"mended":[],"rounds":[]})",
      std::string(1, '\2') + R"({"steps":[{"command":"a","line":"s2gs a","wall_seconds":1,"cpu_seconds":2}],)"
                             R"("stages":[{"name":"a","run":true,"reason":"b","seconds":3}]})",
      std::string(1, '\3') +
          R"({"event":"held_out","psnr_db":30.5,"iteration":5,"count":7,"seconds":1,"loss":0.5})"
          "\n{}\n"};
}

// Whatever the files say, the page has no more scripts than without them, and its figures are JSON.
extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  s2gs::Reporter silent;
  static const size_t num_scripts = [&] {
    fs::create_directories(Workspace().root);
    s2gs::WriteScanReport(Workspace(), {}, silent);
    return CountScripts(Content(Workspace().ReportHtml()));
  }();
  if (size == 0) return 0;
  const std::vector<fs::path> files = Files();
  const fs::path& path = files[data[0] % files.size()];
  fs::create_directories(path.parent_path());
  std::ofstream(path, std::ios::binary)
      .write(reinterpret_cast<const char*>(data) + 1, static_cast<std::streamsize>(size - 1));
  try {
    s2gs::WriteScanRecord(Workspace().ScanRecord(), s2gs::ReadScanRecord(Workspace().ScanRecord()));
    s2gs::ScanSummary summary;
    s2gs::CollectFigures(Workspace(), &summary);
    std::ostringstream shown;
    s2gs::PrintScanSummary(summary, shown);
    s2gs::WriteScanReport(Workspace(), {}, silent);
    if (CountScripts(Content(Workspace().ReportHtml())) > num_scripts) std::abort();
    if (!nlohmann::json::accept(Content(Workspace().ReportJson()))) std::abort();
  } catch (const s2gs::UserError&) {
  }
  for (const fs::path& file : files) fs::remove(file);
  return 0;
}
