#pragma once

#include <filesystem>
#include <fstream>
#include <functional>
#include <ostream>
#include <string>
#include <vector>

namespace s2gs {

/// Opens a file for binary reading.
/// \param remedy  what the user can do when the file is missing, e.g. "Run `colmap mapper` first".
/// Throws UserError with the path and the reason (missing, a folder, a device or pipe, no permission).
std::ifstream OpenForReading(const std::filesystem::path& path, const std::string& remedy = "");

/// Writes a file so that, whatever moment the program is killed at, `path` holds either its old content or
/// the complete new one: the bytes go to a temporary file beside it, which is synced to disk and renamed.
/// \param write  writes the content into the stream it is given; may throw, then nothing is replaced. The
/// stream
///               can seek, and throws UserError itself as soon as the disk is full.
/// Permissions of an existing file are kept; a symbolic link stays, and the file that it leads to is
/// replaced. Throws UserError when the folder is missing or not writable, the disk is full, or `path` is a
/// folder, device or pipe. Different files may be written from several threads at once.
void WriteFileAtomically(const std::filesystem::path& path, const std::function<void(std::ostream&)>& write);

/// The same for a file that another library writes by itself: `write` gets the temporary file's path, in the
/// same folder and with the same extension, and must have closed it when it returns.
void WriteFileAtomicallyByPath(const std::filesystem::path& path,
                               const std::function<void(const std::filesystem::path&)>& write);

/// A file of a set that belongs together.
struct FileToWrite {
  std::filesystem::path path;
  std::function<void(std::ostream&)> write;  ///< writes the content; may throw, then nothing is replaced.
};

/// Writes several files that only make sense together. All are complete on disk before the first one is
/// replaced, so a full disk or a writer that throws changes nothing; what remains is the moment between the
/// renames. `obsolete` files (that may not exist) are removed just before the first rename.
/// Throws like WriteFileAtomically.
void WriteFilesTogether(const std::vector<FileToWrite>& files,
                        const std::vector<std::filesystem::path>& obsolete = {});

/// Removes the temporary files that runs which were killed left in `folder` (not below it), for the start of
/// a run: those of other processes that still run are left alone, those of this process go.
void RemoveStaleTemporaries(const std::filesystem::path& folder);

/// Whether a file's name (without folder) is that of a temporary file of WriteFileAtomically.
bool IsTemporaryName(const std::string& name);

/// Makes a file, or a folder with everything below it, that another program wrote survive a power cut.
/// Throws UserError when the system cannot write it completely.
void SyncToDisk(const std::filesystem::path& path);

/// Creates a folder and its parents. Throws UserError with the path and the reason.
void CreateFolder(const std::filesystem::path& folder);

/// Whether something is there; false, too, where that cannot be told.
bool Exists(const std::filesystem::path& path);

/// A whole file as a string. Throws like OpenForReading; refuses files over `max_bytes`.
std::string ReadWholeFile(const std::filesystem::path& path, uint64_t max_bytes,
                          const std::string& remedy = "");

}  // namespace s2gs
