#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <limits>
#include <optional>
#include <string>
#include <string_view>

#include "sfm_split/base/error.h"

struct sqlite3;
struct sqlite3_stmt;

namespace s2gs {

enum class SqliteAccess {
  kReadOnly,   ///< the file, its folder and the files beside it stay as they are, to the byte.
  kReadWrite,  ///< an existing file.
  kCreate,     ///< a new file; fails when there is one.
};

/// One open SQLite file whose content cannot be trusted: views, triggers and the schema's functions are off,
/// and every error is thrown as UserError with the path and what to do.
///
/// Read-only access leaves no trace, also in folders that cannot be written: a database in WAL mode, which
/// SQLite would otherwise create files beside, is read without locks, together with what its -wal file holds.
/// Should another program change it meanwhile, the next Step() throws.
class SqliteConnection {
 public:
  /// \param busy_timeout_ms  how long to wait for another program's lock [ms].
  SqliteConnection(std::filesystem::path path, SqliteAccess access, int busy_timeout_ms);
  SqliteConnection(const SqliteConnection&) = delete;
  SqliteConnection& operator=(const SqliteConnection&) = delete;
  ~SqliteConnection();

  /// Closes the file; what SQLite keeps beside it is folded in and removed, unless another program has it
  /// open. Throws when that fails, where the destructor stays silent.
  void Close();

  /// Runs statements that return nothing of interest.
  void Execute(const std::string& sql);

  const std::filesystem::path& path() const { return path_; }
  sqlite3* handle() const { return handle_; }

  /// The largest number of steps of SQLite's virtual machine that one statement may take; none: no limit.
  /// A damaged B-tree can otherwise hold a small file's pages so that walking it never ends.
  void LimitSteps(std::optional<int> max_steps);

  /// Throws when another program changed a file that is read without locks.
  void CheckUnchanged() const;

  /// Throws what SQLite says about its last call on this connection.
  [[noreturn]] void Fail(int result, const std::string& doing) const;

 private:
  struct FileStamp {
    uint64_t inode = 0;
    int64_t size = 0;
    int64_t modified_ns = 0;
    bool operator==(const FileStamp& other) const {
      return inode == other.inode && size == other.size && modified_ns == other.modified_ns;
    }
  };
  static FileStamp Stamp(const std::filesystem::path& path);
  void OpenReadOnly(const std::filesystem::path& absolute);
  void OpenWithLocks(const std::filesystem::path& absolute, int flags);

  std::filesystem::path path_;
  std::filesystem::path database_path_;  // absolute, links followed.
  std::filesystem::path wal_path_;
  sqlite3* handle_ = nullptr;
  bool is_lockless_ = false;
  FileStamp database_stamp_;
  FileStamp wal_stamp_;
};

/// A prepared statement. Columns and parameters are numbered from 0. Values are checked against the type that
/// they must have, because SQLite lets any column of any row hold any type.
class SqliteStatement {
 public:
  /// \param subject  what the statement is about, for messages, e.g. "table keypoints".
  SqliteStatement(const SqliteConnection& connection, std::string_view sql, std::string subject);
  SqliteStatement(const SqliteStatement&) = delete;
  SqliteStatement& operator=(const SqliteStatement&) = delete;
  ~SqliteStatement();

  void BindInteger(int index, int64_t value);
  void BindReal(int index, double value);
  void BindNull(int index);
  /// The bytes must live until the statement was stepped.
  void BindText(int index, std::string_view text);
  /// As BindText; no bytes are bound as an empty blob.
  void BindBlob(int index, const void* bytes, uint64_t size);

  /// Moves to the next row; false after the last one.
  bool Step();
  /// Steps to the end of a statement that returns no rows, and makes it ready for the next parameters.
  void Run();

  bool IsNull(int column) const;
  int64_t Integer(int column, int64_t min = std::numeric_limits<int64_t>::min(),
                  int64_t max = std::numeric_limits<int64_t>::max()) const;
  double Real(int column) const;
  /// Valid until the next Step().
  std::string_view Text(int column) const;
  /// Empty for NULL; valid until the next Step().
  std::string_view Blob(int column) const;

  /// Throws that the row at hand holds something impossible.
  [[noreturn]] void FailContent(const std::string& problem) const;

 private:
  void CheckBind(int result) const;

  const SqliteConnection& connection_;
  sqlite3_stmt* statement_ = nullptr;
  std::string subject_;
};

/// Copies a database with SQLite's backup interface, which sees what a -wal file still holds.
/// The copy is in rollback mode: no other files belong to it.
/// \param on_progress  called with (pages done, pages in all) every few megabytes; may throw to stop.
void CopySqliteContent(const SqliteConnection& from, SqliteConnection& to,
                       const std::function<void(int64_t done, int64_t total)>& on_progress);

/// Removes the -wal, -shm and -journal files that belong to a database about to be replaced: SQLite would
/// replay them into the new one.
void RemoveSqliteSideFiles(const std::filesystem::path& database);

}  // namespace s2gs
