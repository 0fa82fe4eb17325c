#include "plugin/stage/fingerprint.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#define XXH_INLINE_ALL
#include <fmt/format.h>
#include <xxhash.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <ctime>
#include <memory>
#include <system_error>
#include <vector>

#include "sfm_split/base/error.h"
#include "sfm_split/base/parallel_for.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

constexpr size_t kChunkBytes = 1 << 20;
// Time stamps of files are as coarse as 2 s (FAT): a file that changed less than that ago may change again
// under the same time.
constexpr int64_t kCoarsestTimeNs = 2'000'000'000;

class Hash {
 public:
  Hash() : state_(XXH3_createState(), XXH3_freeState) { XXH3_64bits_reset(state_.get()); }
  void Add(const void* data, size_t size) { XXH3_64bits_update(state_.get(), data, size); }
  void Add(uint64_t value) { Add(&value, sizeof(value)); }
  void Add(const std::string& text) {
    Add(static_cast<uint64_t>(text.size()));
    Add(text.data(), text.size());
  }
  uint64_t Value() const { return XXH3_64bits_digest(state_.get()); }
  std::string Text() const { return fmt::format("{:016x}", Value()); }

 private:
  std::unique_ptr<XXH3_state_t, decltype(&XXH3_freeState)> state_;
};

struct File {
  std::string name;  // relative to the folder; empty for a single file
  fs::path path;
  uint64_t num_bytes = 0;
  int64_t modified_ns = 0;
  int64_t changed_ns = 0;
  uint64_t inode = 0;
};

int64_t Nanoseconds(const timespec& time) { return int64_t{time.tv_sec} * 1'000'000'000 + time.tv_nsec; }

// Only regular files count: reading anything else might wait forever.
void AddFile(const fs::path& path, const std::string& name, std::vector<File>* files) {
  struct stat status = {};
  if (::stat(path.c_str(), &status) != 0 || !S_ISREG(status.st_mode)) return;
  files->push_back({name, path, static_cast<uint64_t>(status.st_size), Nanoseconds(status.st_mtim),
                    Nanoseconds(status.st_ctim), static_cast<uint64_t>(status.st_ino)});
}

std::vector<File> ListFiles(const fs::path& path) {
  std::vector<File> files;
  std::error_code ec;
  if (!fs::is_directory(path, ec)) {
    AddFile(path, "", &files);
    return files;
  }
  fs::recursive_directory_iterator entry(path, ec);
  for (const fs::recursive_directory_iterator end; !ec && entry != end; entry.increment(ec)) {
    std::error_code is_folder_ec;
    if (entry->path().filename().native()[0] == '.') {
      if (entry->is_directory(is_folder_ec)) entry.disable_recursion_pending();
    } else if (!entry->is_directory(is_folder_ec)) {
      AddFile(entry->path(), entry->path().lexically_relative(path).string(), &files);
    }
  }
  if (ec) throw UserError(path, "cannot be listed (" + ec.message() + ")", "Check that you may read it");
  std::sort(files.begin(), files.end(), [](const File& a, const File& b) { return a.name < b.name; });
  return files;
}

uint64_t HashFile(const File& file, const Reporter& reporter) {
  const int fd = ::open(file.path.c_str(), O_RDONLY | O_CLOEXEC);
  const auto fail = [&](int error) {
    if (fd >= 0) ::close(fd);
    throw UserError(file.path, std::string("cannot be read (") + std::strerror(error) + ")",
                    "Check that you may read it");
  };
  if (fd < 0) fail(errno);
  Hash hash;
  std::vector<char> chunk(static_cast<size_t>(std::min<uint64_t>(kChunkBytes, file.num_bytes + 1)));
  while (true) {
    const ssize_t count = ::read(fd, chunk.data(), chunk.size());
    if (count < 0 && errno == EINTR) continue;
    if (count < 0) fail(errno);
    if (count == 0) break;
    hash.Add(chunk.data(), static_cast<size_t>(count));
    if (reporter.StopRequested()) {
      ::close(fd);
      throw Interrupted();
    }
  }
  ::close(fd);
  return hash.Value();
}

Fingerprint StateOf(const fs::path& path, const std::vector<File>& files) {
  Fingerprint result;
  std::error_code ec;
  result.exists = fs::exists(path, ec);
  result.num_files = files.size();
  timespec now = {};
  ::clock_gettime(CLOCK_REALTIME, &now);
  bool is_settled = true;
  Hash hash;
  for (const File& file : files) {
    result.num_bytes += file.num_bytes;
    hash.Add(file.name);
    for (const uint64_t value : {file.num_bytes, static_cast<uint64_t>(file.modified_ns),
                                 static_cast<uint64_t>(file.changed_ns), file.inode}) {
      hash.Add(value);
    }
    is_settled = is_settled && file.changed_ns < Nanoseconds(now) - kCoarsestTimeNs;
  }
  if (is_settled) result.state = hash.Text();
  return result;
}

std::string ContentOf(const std::vector<File>& files, const Reporter& reporter) {
  std::vector<uint64_t> hashes(files.size());
  ParallelFor(static_cast<int64_t>(files.size()), 0,
              [&](int64_t i) { hashes[i] = HashFile(files[i], reporter); });
  Hash hash;
  for (size_t i = 0; i < files.size(); ++i) {
    hash.Add(files[i].name);
    hash.Add(hashes[i]);
  }
  return hash.Text();
}

}  // namespace

Fingerprint TakeState(const fs::path& path) { return StateOf(path, ListFiles(path)); }

Fingerprint TakeFingerprint(const fs::path& path, const Reporter& reporter) {
  const std::vector<File> files = ListFiles(path);
  Fingerprint result = StateOf(path, files);
  result.content = ContentOf(files, reporter);
  return result;
}

Fingerprint RefreshFingerprint(const fs::path& path, const Fingerprint& known, const Reporter& reporter) {
  const std::vector<File> files = ListFiles(path);
  Fingerprint result = StateOf(path, files);
  const bool is_unchanged =
      result.exists == known.exists && !result.state.empty() && result.state == known.state;
  result.content = is_unchanged && !known.content.empty() ? known.content : ContentOf(files, reporter);
  return result;
}

}  // namespace s2gs
