#include "plugin/stage/stage_stamp.h"

#include <ctime>
#include <nlohmann/json.hpp>
#include <ostream>
#include <system_error>

#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

constexpr int kStampVersion = 1;
constexpr uint64_t kMaxStampBytes = 1 << 24;

Json ToJson(const std::vector<StampedPath>& paths) {
  Json list = Json::array();
  for (const auto& [path, print] : paths) {
    list.push_back({{"path", path},
                    {"exists", print.exists},
                    {"files", print.num_files},
                    {"bytes", print.num_bytes},
                    {"state", print.state},
                    {"content", print.content}});
  }
  return list;
}

std::vector<StampedPath> PathsFromJson(const Json& list) {
  std::vector<StampedPath> paths;
  for (const Json& item : list) {
    StampedPath& stamped = paths.emplace_back();
    stamped.path = item.at("path").get<std::string>();
    stamped.fingerprint.exists = item.at("exists").get<bool>();
    stamped.fingerprint.num_files = item.at("files").get_ref<const uint64_t&>();
    stamped.fingerprint.num_bytes = item.at("bytes").get_ref<const uint64_t&>();
    stamped.fingerprint.state = item.at("state").get<std::string>();
    stamped.fingerprint.content = item.at("content").get<std::string>();
  }
  return paths;
}

}  // namespace

std::string UtcNow() {
  const std::time_t now = std::time(nullptr);
  std::tm utc = {};
  ::gmtime_r(&now, &utc);
  char text[32] = {};
  std::strftime(text, sizeof(text), "%Y-%m-%dT%H:%M:%SZ", &utc);
  return text;
}

std::string StampPath(const Workspace& workspace, const fs::path& path) {
  // A folder may be given with a slash at its end or without.
  const auto plain = [](const fs::path& given) {
    std::error_code ec;
    const fs::path absolute = fs::absolute(given, ec).lexically_normal();
    return absolute.has_filename() ? absolute : absolute.parent_path();
  };
  const fs::path absolute = plain(path);
  const fs::path relative = absolute.lexically_relative(plain(workspace.root));
  const bool is_inside = !relative.empty() && *relative.begin() != "..";
  return is_inside ? relative.string() : absolute.string();
}

std::optional<StageStamp> ReadStageStamp(const Workspace& workspace, const std::string& name,
                                         Reporter& reporter) {
  const fs::path path = workspace.StageStamp(name);
  std::error_code ec;
  if (!fs::exists(path, ec)) return std::nullopt;
  try {
    const Json json = Json::parse(ReadWholeFile(path, kMaxStampBytes));
    if (json.at("version").get_ref<const int64_t&>() != kStampVersion)
      throw UserError(path, "is of another version", "");
    StageStamp stamp;
    stamp.run_id = json.at("run_id").get<std::string>();
    stamp.program_version = json.at("program_version").get<std::string>();
    stamp.finished = json.at("finished").get<std::string>();
    stamp.seconds = json.at("seconds").get<double>();
    stamp.reason = json.value("reason", "");
    stamp.options = json.at("options").get<std::map<std::string, std::string>>();
    stamp.inputs = PathsFromJson(json.at("inputs"));
    stamp.outputs = PathsFromJson(json.at("outputs"));
    stamp.upstream = json.at("upstream").get<std::map<std::string, std::string>>();
    return stamp;
  } catch (const UserError& error) {
    reporter.Warn(std::string(error.what()) + ": " + name + " counts as not done");
  } catch (const Json::exception& error) {
    reporter.Warn(path.string() + ": damaged (" + error.what() + "): " + name + " counts as not done");
  }
  return std::nullopt;
}

void WriteStageStamp(const Workspace& workspace, const std::string& name, const StageStamp& stamp) {
  const Json json = {{"version", kStampVersion},       {"stage", name},
                     {"run_id", stamp.run_id},         {"program_version", stamp.program_version},
                     {"finished", stamp.finished},     {"seconds", stamp.seconds},
                     {"reason", stamp.reason},         {"options", stamp.options},
                     {"inputs", ToJson(stamp.inputs)}, {"outputs", ToJson(stamp.outputs)},
                     {"upstream", stamp.upstream}};
  CreateFolder(workspace.Stages());
  WriteFileAtomically(workspace.StageStamp(name), [&](std::ostream& stream) {
    // File names may hold bytes that are no UTF-8.
    stream << json.dump(2, ' ', false, Json::error_handler_t::replace) << "\n";
  });
}

void RemoveStageStamp(const Workspace& workspace, const std::string& name) {
  std::error_code ec;
  fs::remove(workspace.StageStamp(name), ec);
  if (ec) {
    throw UserError(workspace.StageStamp(name), "cannot be removed (" + ec.message() + ")",
                    "Check that you may write in the workspace");
  }
}

}  // namespace s2gs
