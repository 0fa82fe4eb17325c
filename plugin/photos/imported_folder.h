#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "plugin/stage/workspace.h"

namespace s2gs {

/// What lies in the folder of imported photos and who put it there. Other importers, of video, use it, too.
class ImportedFolder {
 public:
  /// Throws UserError when the folder has files of others, or is or holds a symbolic link: a workspace from
  /// elsewhere may have one that leads to photos.
  /// \param origin  what the photos are made from and how: when it is another one, all of the earlier are
  ///                made again.
  ImportedFolder(const Workspace& workspace, const std::string& origin);

  /// Removes the earlier photos that are not among these, and notes these as ours. Called before any is
  /// written.
  void Expect(const std::vector<std::string>& names);

  /// The path to write a photo of this name at; its folder exists.
  std::filesystem::path Make(const std::string& name) const;

  /// Whether an earlier run wrote it from the file as it is now; Done() marks it so.
  bool IsDone(const std::string& name, const std::filesystem::path& source) const;
  void Done(const std::string& name, const std::filesystem::path& source) const;

 private:
  Workspace workspace_;
  std::string origin_;
  std::vector<std::string> earlier_;
};

}  // namespace s2gs
