// The JSON files of a scan as its report reads them: the first byte of the input chooses the file.

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>

#include "plugin/report/scan_report.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/reporter.h"
#include "tests/fuzz/fuzz_seeds.h"
#include "tests/fuzz/scan_json_files.h"

namespace {

// Of scripts and pictures, which no text from a file may add to.
size_t CountScripts(const std::string& page) {
  size_t count = 0;
  for (const char* mark : {"<script", "<img "}) {
    for (size_t at = page.find(mark); at != std::string::npos; at = page.find(mark, at + 1)) ++count;
  }
  return count;
}

}  // namespace

std::vector<std::string> FuzzSeeds() { return s2gs::ScanJsonSeeds(); }

// Whatever the files say, the page has no more scripts than without them, and its figures are JSON.
extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  const s2gs::Workspace& workspace = s2gs::FuzzedWorkspace();
  s2gs::Reporter silent;
  static const size_t num_scripts = [&] {
    std::filesystem::create_directories(workspace.root);
    s2gs::WriteScanReport(workspace, {}, silent);
    return CountScripts(s2gs::FileContent(workspace.ReportHtml()));
  }();
  if (size == 0) return 0;
  s2gs::WriteFuzzedFile(data, size);
  try {
    s2gs::WriteScanReport(workspace, {}, silent);
  } catch (const s2gs::UserError&) {
    return 0;
  }
  if (CountScripts(s2gs::FileContent(workspace.ReportHtml())) > num_scripts) std::abort();
  if (!nlohmann::json::accept(s2gs::FileContent(workspace.ReportJson()))) std::abort();
  return 0;
}
