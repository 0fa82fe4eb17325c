// The JSON files of a scan as its summary reads them: the first byte of the input chooses the file.

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <nlohmann/json.hpp>
#include <sstream>

#include "plugin/report/scan_summary.h"
#include "tests/fuzz/fuzz_seeds.h"
#include "tests/fuzz/scan_json_files.h"

std::vector<std::string> FuzzSeeds() { return s2gs::ScanJsonSeeds(); }

// Whatever the files say, a summary is made of them, and the record that is written says what was read.
extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  if (size == 0) return 0;
  s2gs::WriteFuzzedFile(data, size);
  const s2gs::Workspace& workspace = s2gs::FuzzedWorkspace();
  s2gs::ScanSummary summary;
  s2gs::CollectFigures(workspace, &summary);
  std::ostringstream shown;
  s2gs::PrintScanSummary(summary, shown);
  const s2gs::ScanSummary record = s2gs::ReadScanRecord(workspace.ScanRecord());
  s2gs::WriteScanRecord(workspace.ScanRecord(), record);
  if (!nlohmann::json::accept(s2gs::FileContent(workspace.ScanRecord()))) std::abort();
  const s2gs::ScanSummary again = s2gs::ReadScanRecord(workspace.ScanRecord());
  if (again.steps.size() != record.steps.size() || again.stages.size() != record.stages.size()) std::abort();
  return 0;
}
