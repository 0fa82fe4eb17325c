#include "sfm_split/scene/io/sqlite_connection.h"

#include <sqlite3.h>
#include <sys/stat.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <fstream>
#include <utility>

#include "sfm_split/base/file_io.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

// Of a database that SQLite or a reader calls damaged.
constexpr char kDamagedRemedy[] =
    "Restore it from a copy, or delete it and run feature extraction and matching again";

fs::path WithSuffix(const fs::path& path, const char* suffix) {
  fs::path result = path;
  result += suffix;
  return result;
}

// A SQLite file says in its header whether readers must look for a write-ahead log.
bool IsInWalMode(const fs::path& path) {
  std::ifstream stream = OpenForReading(path);
  constexpr size_t kReadVersionOffset = 19;  // bytes; sqlite.org/fileformat.html 1.3
  std::array<char, kReadVersionOffset + 1> header{};
  stream.read(header.data(), header.size());
  return stream && header[kReadVersionOffset] == 2;
}

// SQLite's URI form, the only way to ask for an immutable file.
std::string ImmutableUri(const fs::path& absolute) {
  constexpr char kHexDigits[] = "0123456789abcdef";  // of an escaped character
  std::string uri = "file://";
  for (const char c : absolute.string()) {
    if (c == '%' || c == '?' || c == '#') {
      uri += '%';
      uri += kHexDigits[c / 16];
      uri += kHexDigits[c % 16];
    } else {
      uri += c;
    }
  }
  return uri + "?immutable=1";
}

}  // namespace

SqliteConnection::FileStamp SqliteConnection::Stamp(const fs::path& path) {
  struct stat status {};
  // An empty log says the same as none.
  if (::stat(path.c_str(), &status) != 0 || status.st_size == 0) return {};
  return {status.st_ino, status.st_size, status.st_mtim.tv_sec * 1'000'000'000 + status.st_mtim.tv_nsec};
}

SqliteConnection::SqliteConnection(fs::path path, SqliteAccess access, int busy_timeout_ms)
    : path_(std::move(path)) {
  // SQLite keeps its other files beside the file that a link leads to.
  std::error_code ec;
  const fs::path absolute = fs::weakly_canonical(fs::absolute(path_), ec);
  if (ec) throw UserError(path_, "cannot be found (" + ec.message() + ")", "Correct the path");
  database_path_ = absolute;
  wal_path_ = WithSuffix(absolute, "-wal");
  const fs::file_status status = fs::status(absolute, ec);
  try {
    if (access == SqliteAccess::kCreate) {
      if (fs::exists(status)) {
        throw UserError(path_, "exists already", "Delete it or choose another name");
      }
      OpenWithLocks(absolute, SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE);
    } else {
      OpenForReading(absolute, "Run `colmap feature_extractor` first, or correct the path");
      if (!fs::is_regular_file(status)) {
        throw UserError(path_, "is not a regular file", "Give the path of a COLMAP database");
      }
      if (access == SqliteAccess::kReadOnly) {
        OpenReadOnly(absolute);
      } else {
        OpenWithLocks(absolute, SQLITE_OPEN_READWRITE);
      }
    }
    sqlite3_extended_result_codes(handle_, 1);
    sqlite3_busy_timeout(handle_, busy_timeout_ms);
    sqlite3_db_config(handle_, SQLITE_DBCONFIG_DEFENSIVE, 1, nullptr);
    sqlite3_db_config(handle_, SQLITE_DBCONFIG_TRUSTED_SCHEMA, 0, nullptr);
    sqlite3_db_config(handle_, SQLITE_DBCONFIG_ENABLE_TRIGGER, 0, nullptr);
    sqlite3_db_config(handle_, SQLITE_DBCONFIG_ENABLE_VIEW, 0, nullptr);
    if (access == SqliteAccess::kReadWrite && sqlite3_db_readonly(handle_, "main") != 0) {
      throw UserError(path_, "cannot be written", "Check its permissions and those of its folder");
    }
  } catch (...) {
    sqlite3_close_v2(handle_);
    throw;
  }
}

SqliteConnection::~SqliteConnection() { sqlite3_close_v2(handle_); }

void SqliteConnection::OpenWithLocks(const fs::path& absolute, int flags) {
  const int result = sqlite3_open_v2(absolute.c_str(), &handle_, flags | SQLITE_OPEN_NOMUTEX, nullptr);
  if (result != SQLITE_OK) Fail(result, "opening it");
}

void SqliteConnection::OpenReadOnly(const fs::path& absolute) {
  // Rollback mode: locks are enough and leave nothing behind.
  if (!IsInWalMode(absolute)) return OpenWithLocks(absolute, SQLITE_OPEN_READONLY);

  is_lockless_ = true;
  database_stamp_ = Stamp(absolute);
  wal_stamp_ = Stamp(wal_path_);
  if (wal_stamp_ == FileStamp()) {
    const int result = sqlite3_open_v2(ImmutableUri(absolute).c_str(), &handle_,
                                       SQLITE_OPEN_READONLY | SQLITE_OPEN_NOMUTEX | SQLITE_OPEN_URI, nullptr);
    if (result != SQLITE_OK) Fail(result, "opening it");
    return;
  }
  // With exclusive locking SQLite keeps the index of the log on the heap instead of in a -shm file; the
  // lockless VFS lets it do so on a file opened for reading. The log must not be folded in on closing.
  const int result =
      sqlite3_open_v2(absolute.c_str(), &handle_, SQLITE_OPEN_READONLY | SQLITE_OPEN_NOMUTEX, "unix-none");
  if (result != SQLITE_OK) Fail(result, "opening it");
  sqlite3_db_config(handle_, SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, 1, nullptr);
  Execute("PRAGMA locking_mode=EXCLUSIVE");
}

void SqliteConnection::Close() {
  if (handle_ == nullptr) return;
  const int result = sqlite3_close(handle_);
  if (result != SQLITE_OK) Fail(result, "closing it");
  handle_ = nullptr;
}

void SqliteConnection::Execute(const std::string& sql) {
  const int result = sqlite3_exec(handle_, sql.c_str(), nullptr, nullptr, nullptr);
  if (result != SQLITE_OK) Fail(result, "\"" + sql + "\"");
}

void SqliteConnection::LimitSteps(std::optional<int> max_steps) {
  const auto stop = [](void*) { return 1; };
  sqlite3_progress_handler(handle_, max_steps.value_or(0), max_steps ? +stop : nullptr, nullptr);
}

void SqliteConnection::CheckUnchanged() const {
  if (!is_lockless_) return;
  if (!(Stamp(database_path_) == database_stamp_) || !(Stamp(wal_path_) == wal_stamp_)) {
    throw UserError(path_, "was changed by another program while it was being read",
                    "Wait for that program (COLMAP?) to finish and run the command again");
  }
}

void SqliteConnection::Fail(int result, const std::string& doing) const {
  const std::string detail = handle_ != nullptr ? sqlite3_errmsg(handle_) : sqlite3_errstr(result);
  CheckUnchanged();
  switch (result & 0xff) {
    case SQLITE_NOTADB:
      throw UserError(path_, "is not a SQLite database", "Give the path of a COLMAP database");
    case SQLITE_BUSY:
    case SQLITE_LOCKED:
      throw UserError(path_, "is locked by another program (" + detail + ")",
                      "Close COLMAP or whatever else has it open, and run the command again");
    case SQLITE_READONLY:
      if (result == SQLITE_READONLY_ROLLBACK) {
        throw UserError(path_, "was being written when that program was stopped, and its -journal file waits",
                        "Open it once with a program that may write it, e.g. `colmap database_cleaner`");
      }
      throw UserError(path_, "cannot be written (" + detail + ")",
                      "Check its permissions and those of its folder");
    case SQLITE_FULL:
      throw UserError(path_, "cannot be written: the disk is full",
                      "Free some space on that disk and run the command again");
    case SQLITE_CANTOPEN:
    case SQLITE_PERM:
      throw UserError(path_, "cannot be opened (" + detail + ")",
                      "Check that the folder exists and that you may read and write there");
    case SQLITE_IOERR:
      if (result != SQLITE_IOERR_SHORT_READ) {
        throw UserError(path_, "cannot be read or written while " + doing + " (" + detail + ")",
                        "Check the disk and the free space on it");
      }
      break;
    case SQLITE_CONSTRAINT:
      throw UserError(path_, doing + " breaks a rule of the database (" + detail + ")",
                      "Check for duplicate names and ids");
    case SQLITE_NOMEM:
    case SQLITE_TOOBIG:
      throw UserError(path_, doing + " takes more memory than there is or SQLite allows (" + detail + ")",
                      "Use fewer features or images, or check the file for damage");
    default:
      break;
  }
  throw UserError(path_, "is damaged: " + doing + " failed (" + detail + ")", kDamagedRemedy);
}

SqliteStatement::SqliteStatement(const SqliteConnection& connection, std::string_view sql,
                                 std::string subject)
    : connection_(connection), subject_(std::move(subject)) {
  const int result =
      sqlite3_prepare_v2(connection.handle(), sql.data(), static_cast<int>(sql.size()), &statement_, nullptr);
  if (result != SQLITE_OK) connection.Fail(result, subject_);
}

SqliteStatement::~SqliteStatement() { sqlite3_finalize(statement_); }

void SqliteStatement::CheckBind(int result) const {
  if (result != SQLITE_OK) connection_.Fail(result, "writing " + subject_);
}

void SqliteStatement::BindInteger(int index, int64_t value) {
  CheckBind(sqlite3_bind_int64(statement_, index + 1, value));
}

void SqliteStatement::BindReal(int index, double value) {
  CheckBind(sqlite3_bind_double(statement_, index + 1, value));
}

void SqliteStatement::BindNull(int index) { CheckBind(sqlite3_bind_null(statement_, index + 1)); }

void SqliteStatement::BindText(int index, std::string_view text) {
  CheckBind(sqlite3_bind_text64(statement_, index + 1, text.data(), text.size(), SQLITE_STATIC, SQLITE_UTF8));
}

void SqliteStatement::BindBlob(int index, const void* bytes, uint64_t size) {
  // A null pointer would bind NULL.
  CheckBind(sqlite3_bind_blob64(statement_, index + 1, size > 0 ? bytes : "", size, SQLITE_STATIC));
}

bool SqliteStatement::Step() {
  const int result = sqlite3_step(statement_);
  if (result != SQLITE_ROW && result != SQLITE_DONE) connection_.Fail(result, "access to " + subject_);
  connection_.CheckUnchanged();
  return result == SQLITE_ROW;
}

void SqliteStatement::Run() {
  while (Step()) {
  }
  sqlite3_reset(statement_);
}

bool SqliteStatement::IsNull(int column) const {
  return sqlite3_column_type(statement_, column) == SQLITE_NULL;
}

int64_t SqliteStatement::Integer(int column, int64_t min, int64_t max) const {
  const std::string name = sqlite3_column_name(statement_, column);
  if (sqlite3_column_type(statement_, column) != SQLITE_INTEGER) {
    FailContent("column " + name + " is not an integer");
  }
  const int64_t value = sqlite3_column_int64(statement_, column);
  if (value < min || value > max) {
    FailContent("column " + name + " is " + std::to_string(value) + ", outside " + std::to_string(min) +
                " to " + std::to_string(max));
  }
  return value;
}

double SqliteStatement::Real(int column) const {
  const int type = sqlite3_column_type(statement_, column);
  if (type != SQLITE_FLOAT && type != SQLITE_INTEGER) {
    FailContent("column " + std::string(sqlite3_column_name(statement_, column)) + " is not a number");
  }
  return sqlite3_column_double(statement_, column);
}

std::string_view SqliteStatement::Text(int column) const {
  if (sqlite3_column_type(statement_, column) != SQLITE_TEXT) {
    FailContent("column " + std::string(sqlite3_column_name(statement_, column)) + " is not text");
  }
  const void* text = sqlite3_column_text(statement_, column);
  const int size = sqlite3_column_bytes(statement_, column);
  if (text == nullptr) connection_.Fail(SQLITE_NOMEM, "reading " + subject_);
  return {static_cast<const char*>(text), static_cast<size_t>(size)};
}

std::string_view SqliteStatement::Blob(int column) const {
  const int type = sqlite3_column_type(statement_, column);
  if (type == SQLITE_NULL) return {};
  if (type != SQLITE_BLOB) {
    FailContent("column " + std::string(sqlite3_column_name(statement_, column)) + " is not a blob");
  }
  const void* bytes = sqlite3_column_blob(statement_, column);
  const int size = sqlite3_column_bytes(statement_, column);
  return {static_cast<const char*>(bytes), static_cast<size_t>(size)};
}

void SqliteStatement::FailContent(const std::string& problem) const {
  throw UserError(connection_.path(), "is damaged: " + subject_ + ": " + problem, kDamagedRemedy);
}

void CopySqliteContent(const SqliteConnection& from, SqliteConnection& to,
                       const std::function<void(int64_t done, int64_t total)>& on_progress) {
  sqlite3_backup* const backup = sqlite3_backup_init(to.handle(), "main", from.handle(), "main");
  if (backup == nullptr) to.Fail(sqlite3_errcode(to.handle()), "copying into it");
  int result = SQLITE_OK;
  try {
    while (result == SQLITE_OK) {
      constexpr int kPagesPerStep = 4096;  // 16 MiB of usual pages between two reports
      result = sqlite3_backup_step(backup, kPagesPerStep);
      from.CheckUnchanged();
      const int total = sqlite3_backup_pagecount(backup);
      if (result == SQLITE_OK) on_progress(total - sqlite3_backup_remaining(backup), total);
    }
  } catch (...) {
    sqlite3_backup_finish(backup);
    throw;
  }
  sqlite3_backup_finish(backup);
  if (result != SQLITE_DONE) {
    // The step reports errors of either side; only a full disk and a failed write are the copy's.
    const bool is_of_copy = (result & 0xff) == SQLITE_FULL || result == SQLITE_IOERR_WRITE;
    (is_of_copy ? static_cast<const SqliteConnection&>(to) : from).Fail(result, "copying it");
  }
  to.Execute("PRAGMA journal_mode=DELETE");
}

void RemoveSqliteSideFiles(const fs::path& database) {
  for (const char* suffix : {"-wal", "-shm", "-journal"}) {
    std::error_code ec;
    const fs::path side_file = WithSuffix(fs::weakly_canonical(fs::absolute(database), ec), suffix);
    if (!ec) fs::remove(side_file, ec);
    if (ec) {
      throw UserError(side_file, "cannot be removed (" + ec.message() + ")",
                      "Remove it: it belongs to the database that is being replaced");
    }
  }
}

}  // namespace s2gs
