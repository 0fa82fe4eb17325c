#include "sfm_split/base/file_io.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <charconv>
#include <csignal>
#include <cstring>
#include <memory>
#include <streambuf>
#include <system_error>
#include <utility>
#include <vector>

#include "sfm_split/base/byte_reader.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/require_writable.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

constexpr char kTemporaryMark[] = ".s2gs-tmp-";  // after a dot and the file's name
constexpr size_t kMaxNameBytes = 255;            // of one path component, on every common file system
constexpr size_t kBufferBytes = 1 << 18;         // a write for each: large beside the cost of a call

[[noreturn]] void ThrowSystemError(const fs::path& path, const std::string& problem, int error) {
  std::string remedy = "Check that the folder exists and that you may write there";
  if (error == ENOSPC || error == EDQUOT) remedy = "Free some space on that disk and run the command again";
  if (error == EFBIG)
    remedy = "A limit on file sizes (`ulimit -f`) or the file system forbids files this large";
  throw UserError(path, problem + " (" + std::strerror(error) + ")", remedy);
}

// "dir/a.ply" -> "dir/.s2gs-tmp-PID-N-a.ply": the extension stays, because some writers choose a format by
// it.
fs::path TemporaryPath(const fs::path& path) {
  static std::atomic<uint64_t> count{0};
  const std::string prefix =
      kTemporaryMark + std::to_string(::getpid()) + "-" + std::to_string(++count) + "-";
  std::string name = path.filename().string();
  if (prefix.size() + name.size() > kMaxNameBytes) name.erase(0, prefix.size() + name.size() - kMaxNameBytes);
  return path.parent_path() / (prefix + name);
}

// What a write to `path` replaces: the file that a link leads to, not the link.
fs::path ResolveTarget(const fs::path& path) {
  if (path.filename().empty()) throw UserError(path, "is not a file's name", "Check the output path");
  std::error_code ec;
  fs::path target = path;
  if (fs::is_symlink(path, ec)) {
    const fs::path resolved = fs::canonical(path, ec);
    if (!ec) target = resolved;
  }
  const fs::file_status status = fs::status(target, ec);
  if (fs::is_directory(status)) throw UserError(path, "is a folder, not a file", "Check the output path");
  if (fs::exists(status) && !fs::is_regular_file(status)) {
    throw UserError(path, "is a device or pipe, not a file", "Write to a file");
  }
  return target;
}

// Syncs a file by its path, for files that another library wrote.
void SyncFile(const fs::path& path, const fs::path& shown_path) {
  const int fd = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (fd < 0) ThrowSystemError(shown_path, "cannot be written", errno);
  const int result = ::fsync(fd);
  const int error = errno;
  ::close(fd);
  if (result != 0) ThrowSystemError(shown_path, "cannot be written completely", error);
}

// Makes a rename in `folder` survive a power cut. Some network file systems cannot, and a folder that may be
// written but not read cannot be opened: the rename is still atomic there, so neither is an error.
void SyncFolder(const fs::path& folder) {
  const int fd = ::open(folder.empty() ? "." : folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (fd < 0) return;
  const int result = ::fsync(fd);
  const int error = errno;
  ::close(fd);
  if (result != 0 && (error == EIO || error == ENOSPC || error == EDQUOT)) {
    ThrowSystemError(folder, "cannot be synced", error);
  }
}

class TemporaryFile {
 public:
  explicit TemporaryFile(const fs::path& path)
      : shown_path_(path), target_(ResolveTarget(path)), path_(TemporaryPath(target_)) {}
  TemporaryFile(const TemporaryFile&) = delete;
  TemporaryFile& operator=(const TemporaryFile&) = delete;
  ~TemporaryFile() {
    if (!is_committed_) ::unlink(path_.c_str());
  }

  const fs::path& path() const { return path_; }

  // The content must be synced.
  void Commit() {
    struct stat old = {};
    // Who may read and write a file does not change because its content does. Where that is not ours to set,
    // the new file keeps the usual permissions.
    if (::stat(target_.c_str(), &old) == 0) static_cast<void>(::chmod(path_.c_str(), old.st_mode & 07777));
    if (::rename(path_.c_str(), target_.c_str()) != 0) {
      ThrowSystemError(shown_path_, "cannot be replaced", errno);
    }
    is_committed_ = true;
    SyncFolder(target_.parent_path());
  }

 private:
  fs::path shown_path_;
  fs::path target_;
  fs::path path_;
  bool is_committed_ = false;
};

// Writes to a file descriptor and throws at the first fault, with the system's reason: std::ofstream forgets
// it, and lets the writer format gigabytes for a disk that has long been full.
class FileWriter : public std::streambuf {
 public:
  FileWriter(const fs::path& path, fs::path shown_path) : shown_path_(std::move(shown_path)) {
    // What a killed run of an equal process id left under this name goes; a link planted there is not
    // followed.
    ::unlink(path.c_str());
    fd_ = ::open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
    if (fd_ < 0) ThrowSystemError(shown_path_, "cannot be written", errno);
    buffer_.resize(kBufferBytes);
    setp(buffer_.data(), buffer_.data() + buffer_.size());
  }
  FileWriter(const FileWriter&) = delete;
  FileWriter& operator=(const FileWriter&) = delete;
  ~FileWriter() override {
    if (fd_ >= 0) ::close(fd_);
  }

  void Finish() {
    Drain();
    if (::fsync(fd_) != 0) Fail(errno);
    if (::close(std::exchange(fd_, -1)) != 0) Fail(errno);
  }

 protected:
  int_type overflow(int_type c) override {
    Drain();
    if (!traits_type::eq_int_type(c, traits_type::eof())) sputc(traits_type::to_char_type(c));
    return traits_type::not_eof(c);
  }
  std::streamsize xsputn(const char* data, std::streamsize count) override {
    if (count < epptr() - pptr()) {
      std::memcpy(pptr(), data, static_cast<size_t>(count));
      pbump(static_cast<int>(count));
    } else {
      Drain();
      WriteAll(data, static_cast<size_t>(count));
    }
    return count;
  }
  int sync() override {
    Drain();
    return 0;
  }
  pos_type seekoff(off_type offset, std::ios::seekdir direction, std::ios::openmode which) override {
    if ((which & std::ios::out) == 0) return pos_type(off_type(-1));
    Drain();
    const int whence = direction == std::ios::beg   ? SEEK_SET
                       : direction == std::ios::cur ? SEEK_CUR
                                                    : SEEK_END;
    return pos_type(::lseek(fd_, offset, whence));
  }
  pos_type seekpos(pos_type position, std::ios::openmode which) override {
    return seekoff(off_type(position), std::ios::beg, which);
  }

 private:
  void Drain() {
    // A fault that the caller swallowed must not let a file with a hole through.
    if (error_ != 0) Fail(error_);
    const auto count = static_cast<size_t>(pptr() - pbase());
    setp(buffer_.data(), buffer_.data() + buffer_.size());
    WriteAll(buffer_.data(), count);
  }
  void WriteAll(const char* data, size_t count) {
    while (count > 0) {
      const ssize_t written = ::write(fd_, data, count);
      if (written < 0 && errno == EINTR) continue;
      if (written <= 0) Fail(written < 0 ? errno : EIO);
      data += written;
      count -= static_cast<size_t>(written);
    }
  }
  [[noreturn]] void Fail(int error) {
    error_ = error;
    ThrowSystemError(shown_path_, "cannot be written completely", error);
  }

  fs::path shown_path_;
  std::vector<char> buffer_;
  int fd_ = -1;
  int error_ = 0;
};

// Writes and syncs the content, without replacing anything yet.
void FillTemporary(const fs::path& path, const std::function<void(std::ostream&)>& write,
                   TemporaryFile* temporary) {
  FileWriter writer(temporary->path(), path);
  std::ostream stream(&writer);
  // Lets the writer's exceptions through.
  stream.exceptions(std::ios::badbit);
  write(stream);
  if (!stream) throw UserError(path, "cannot be written completely", "Please report this");
  writer.Finish();
}

}  // namespace

std::ifstream OpenForReading(const fs::path& path, const std::string& remedy) {
  std::error_code ec;
  const fs::file_status status = fs::status(path, ec);
  if (status.type() == fs::file_type::not_found) throw UserError(path, "no such file", remedy);
  if (fs::is_directory(status)) throw UserError(path, "is a folder, not a file", remedy);
  // Opening a pipe would wait for its writer, and neither can be sized up before it is read.
  if (fs::exists(status) && !fs::is_regular_file(status)) {
    throw UserError(path, "is a device or pipe, not a file", "Only regular files can be read");
  }
  errno = 0;
  std::ifstream stream(path, std::ios::binary);
  if (!stream) {
    throw UserError(path, std::string("cannot be read (") + std::strerror(errno != 0 ? errno : EIO) + ")",
                    "Check that you may read it");
  }
  return stream;
}

void WriteFileAtomically(const fs::path& path, const std::function<void(std::ostream&)>& write) {
  TemporaryFile temporary(path);
  FillTemporary(path, write, &temporary);
  temporary.Commit();
}

void WriteFileAtomicallyByPath(const fs::path& path, const std::function<void(const fs::path&)>& write) {
  TemporaryFile temporary(path);
  write(temporary.path());
  SyncFile(temporary.path(), path);
  temporary.Commit();
}

void WriteFilesTogether(const std::vector<FileToWrite>& files, const std::vector<fs::path>& obsolete) {
  std::vector<std::unique_ptr<TemporaryFile>> temporaries;
  for (const FileToWrite& file : files) {
    temporaries.push_back(std::make_unique<TemporaryFile>(file.path));
    FillTemporary(file.path, file.write, temporaries.back().get());
  }
  for (const fs::path& path : obsolete) {
    if (::unlink(path.c_str()) != 0 && errno != ENOENT) ThrowSystemError(path, "cannot be removed", errno);
  }
  for (const std::unique_ptr<TemporaryFile>& temporary : temporaries) temporary->Commit();
}

bool IsTemporaryName(const std::string& name) { return name.rfind(kTemporaryMark, 0) == 0; }

void RemoveStaleTemporaries(const fs::path& folder) {
  std::error_code ec;
  std::vector<fs::path> stale;
  for (fs::directory_iterator entry(folder, ec), end; !ec && entry != end; entry.increment(ec)) {
    const std::string name = entry->path().filename().string();
    if (!IsTemporaryName(name)) continue;
    const size_t mark = std::strlen(kTemporaryMark);
    pid_t pid = 0;
    const auto parsed = std::from_chars(name.data() + mark, name.data() + name.size(), pid);
    if (parsed.ec != std::errc() || pid <= 0) continue;
    if (parsed.ptr == name.data() + name.size() || *parsed.ptr != '-') continue;
    const bool is_running = ::kill(pid, 0) == 0 || errno == EPERM;
    if (pid == ::getpid() || !is_running) stale.push_back(entry->path());
  }
  for (const fs::path& path : stale) fs::remove(path, ec);
}

void SyncToDisk(const fs::path& path) {
  std::error_code ec;
  if (!fs::is_directory(path, ec)) {
    SyncFile(path, path);
    return;
  }
  SyncFolder(path);
  fs::recursive_directory_iterator entry(path, ec);
  for (const fs::recursive_directory_iterator end; !ec && entry != end; entry.increment(ec)) {
    std::error_code entry_ec;
    const fs::file_status status = entry->status(entry_ec);
    if (fs::is_directory(status)) SyncFolder(entry->path());
    if (fs::is_regular_file(status)) SyncFile(entry->path(), entry->path());
  }
}

void RequireWritable(const fs::path& path) {
  ResolveTarget(path);
  const fs::path folder = path.has_parent_path() ? path.parent_path() : fs::path(".");
  std::error_code ec;
  if (!fs::is_directory(folder, ec)) {
    throw UserError(path, "cannot be written: there is no folder " + folder.string(),
                    "Create it, or check the path");
  }
  if (::access(folder.c_str(), W_OK | X_OK) != 0) ThrowSystemError(path, "cannot be written", errno);
}

void CreateFolder(const fs::path& folder) {
  std::error_code ec;
  if (fs::is_directory(folder, ec)) return;
  std::vector<fs::path> changed;  // folders that get a new entry
  for (fs::path path = folder; !path.empty() && !fs::exists(path, ec); path = path.parent_path()) {
    changed.push_back(path.parent_path());
    if (path == path.parent_path()) break;
  }
  fs::create_directories(folder, ec);
  std::error_code is_folder_ec;
  if (!fs::is_directory(folder, is_folder_ec)) {
    throw UserError(folder, "cannot be created as a folder (" + (ec ? ec.message() : "not a folder") + ")",
                    ec == std::errc::no_space_on_device ? "Free some space on that disk"
                                                        : "Check the path and that you may write there");
  }
  for (const fs::path& path : changed) SyncFolder(path);
}

bool Exists(const fs::path& path) {
  std::error_code ec;
  return fs::exists(path, ec);
}

std::string ReadWholeFile(const fs::path& path, uint64_t max_bytes, const std::string& remedy) {
  std::ifstream stream = OpenForReading(path, remedy);
  const uint64_t size = RemainingBytes(stream, path);
  if (size > max_bytes) {
    throw UserError(path,
                    "is " + std::to_string(size) + " bytes long, more than the " + std::to_string(max_bytes) +
                        " that a file of this kind can have",
                    remedy);
  }
  std::string content(size, '\0');
  stream.read(content.data(), static_cast<std::streamsize>(size));
  if (static_cast<uint64_t>(stream.gcount()) != size) {
    throw UserError(path, "cannot be read completely", "Check the disk that it is on");
  }
  return content;
}

}  // namespace s2gs
