#include "sfm_split/file_io.h"

#include <fcntl.h>
#include <signal.h>
#include <unistd.h>

#include <cerrno>
#include <charconv>
#include <cstring>
#include <memory>
#include <system_error>

#include "sfm_split/error.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

constexpr char kTemporaryMark[] = ".s2gs-tmp-";

// "dir/a.ply" -> "dir/.s2gs-tmp-PID-a.ply": the extension stays, because some writers choose a format by it.
fs::path TemporaryPath(const fs::path& path) {
  return path.parent_path() / (kTemporaryMark + std::to_string(::getpid()) + "-" + path.filename().string());
}

[[noreturn]] void ThrowSystemError(const fs::path& path, const std::string& problem, int error) {
  std::string remedy = "Check that the folder exists and that you may write there";
  if (error == ENOSPC || error == EDQUOT) remedy = "Free some space on that disk and run the command again";
  throw UserError(path, problem + " (" + std::strerror(error) + ")", remedy);
}

void SyncPath(const fs::path& path, int flags) {
  const int fd = ::open(path.c_str(), flags | O_CLOEXEC);
  if (fd < 0) ThrowSystemError(path, "cannot be opened", errno);
  const int result = ::fsync(fd);
  const int error = errno;
  ::close(fd);
  // Some network file systems cannot sync a folder; the rename is still atomic there.
  if (result != 0 && error != EINVAL && error != EROFS) ThrowSystemError(path, "cannot be synced", error);
}

class TemporaryFile {
 public:
  explicit TemporaryFile(const fs::path& final_path)
      : final_path_(final_path), path_(TemporaryPath(final_path)) {}
  TemporaryFile(const TemporaryFile&) = delete;
  TemporaryFile& operator=(const TemporaryFile&) = delete;
  ~TemporaryFile() {
    if (!committed_) ::unlink(path_.c_str());
  }

  const fs::path& path() const { return path_; }

  // Lets `write` fill the file. All failures name the final path, which is the one that the user knows.
  void Fill(const std::function<void(std::ostream&)>& write) {
    errno = 0;
    std::ofstream stream(path_, std::ios::binary | std::ios::trunc);
    if (!stream) ThrowSystemError(final_path_, "cannot be written", errno);
    errno = 0;  // A stream does not say why it failed; errno of its last system call does.
    write(stream);
    stream.flush();
    if (!stream) ThrowSystemError(final_path_, "cannot be written completely", errno != 0 ? errno : EIO);
    stream.close();
    if (!stream) ThrowSystemError(final_path_, "cannot be written completely", errno != 0 ? errno : EIO);
  }

  void Sync() { SyncPath(path_, O_RDONLY); }

  // Syncs, unless that was done already, and replaces the final file.
  void Commit(bool is_synced = false) {
    if (!is_synced) Sync();
    if (::rename(path_.c_str(), final_path_.c_str()) != 0) {
      ThrowSystemError(final_path_, "cannot be replaced", errno);
    }
    committed_ = true;
    const fs::path folder = final_path_.parent_path();
    SyncPath(folder.empty() ? fs::path(".") : folder, O_RDONLY | O_DIRECTORY);
  }

 private:
  fs::path final_path_;
  fs::path path_;
  bool committed_ = false;
};

}  // namespace

std::ifstream OpenForReading(const fs::path& path, const std::string& remedy) {
  std::error_code ec;
  const fs::file_status status = fs::status(path, ec);
  if (status.type() == fs::file_type::not_found) throw UserError(path, "no such file", remedy);
  if (status.type() == fs::file_type::directory) throw UserError(path, "is a folder, not a file", remedy);
  std::ifstream stream(path, std::ios::binary);
  if (!stream) throw UserError(path, std::string("cannot be read (") + std::strerror(errno) + ")", remedy);
  return stream;
}

void WriteFileAtomically(const fs::path& path, const std::function<void(std::ostream&)>& write) {
  TemporaryFile temporary(path);
  temporary.Fill(write);
  temporary.Commit();
}

void WriteFileAtomicallyByPath(const fs::path& path, const std::function<void(const fs::path&)>& write) {
  TemporaryFile temporary(path);
  write(temporary.path());
  temporary.Commit();
}

void WriteFilesTogether(const std::vector<FileToWrite>& files, const std::vector<fs::path>& obsolete) {
  std::vector<std::unique_ptr<TemporaryFile>> temporaries;
  for (const FileToWrite& file : files) {
    temporaries.push_back(std::make_unique<TemporaryFile>(file.path));
    temporaries.back()->Fill(file.write);
    temporaries.back()->Sync();
  }
  for (const fs::path& path : obsolete) {
    if (::unlink(path.c_str()) != 0 && errno != ENOENT) ThrowSystemError(path, "cannot be removed", errno);
  }
  for (const std::unique_ptr<TemporaryFile>& temporary : temporaries) temporary->Commit(/*is_synced=*/true);
}

void RemoveStaleTemporaries(const fs::path& folder) {
  std::error_code ec;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder, ec)) {
    const std::string name = entry.path().filename().string();
    const size_t mark = std::strlen(kTemporaryMark);
    if (name.compare(0, mark, kTemporaryMark) != 0) continue;
    int64_t pid = 0;
    const auto parsed = std::from_chars(name.data() + mark, name.data() + name.size(), pid);
    if (parsed.ec != std::errc() || *parsed.ptr != '-') continue;
    const bool is_running = ::kill(static_cast<pid_t>(pid), 0) == 0 || errno == EPERM;
    if (pid == ::getpid() || !is_running) fs::remove(entry.path(), ec);
  }
}

void CreateFolder(const fs::path& folder) {
  std::error_code ec;
  fs::create_directories(folder, ec);
  if (ec || !fs::is_directory(folder)) {
    throw UserError(folder, "cannot be created as a folder (" + ec.message() + ")",
                    "Check the path and that you may write there");
  }
}

std::string ReadWholeFile(const fs::path& path, uint64_t max_bytes, const std::string& remedy) {
  std::ifstream stream = OpenForReading(path, remedy);
  const uint64_t size = fs::file_size(path);
  if (size > max_bytes) {
    throw UserError(path,
                    "is " + std::to_string(size) + " bytes long, more than the " + std::to_string(max_bytes) +
                        " that a file of this kind can have",
                    remedy);
  }
  std::string content(size, '\0');
  stream.read(content.data(), static_cast<std::streamsize>(size));
  if (static_cast<uint64_t>(stream.gcount()) != size)
    throw UserError(path, "cannot be read completely", remedy);
  return content;
}

}  // namespace s2gs
