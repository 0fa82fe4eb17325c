#pragma once

#include <filesystem>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace s2gs {

/// The name of an image: its path relative to the folder of the photos, with '/' between folders. Names come
/// from models, databases and JSON files that others may have made, and become paths that are written: every
/// reader passes them through this type's bounds.
class ImageName {
 public:
  /// Why a text can be no name, as the end of a sentence that begins with it ("is an absolute path"); nothing
  /// when it can. A name is valid UTF-8 of at most 1024 bytes without control characters and backslashes,
  /// does not begin or end with a space (COLMAP's text files could not hold it), and none of its parts is
  /// empty, ".", ".." or longer than 240 bytes: with ".geometric.bin" after it, it is still a file's name.
  static std::optional<std::string> FindFault(std::string_view text);

  /// Throws UserError that quotes the name and says what it comes from.
  /// \param source  the file or folder that the name comes from.
  ImageName(std::string text, const std::filesystem::path& source);

  const std::string& text() const { return text_; }

 private:
  std::string text_;
};

/// "\"NAME\" FAULT", fit to be printed.
std::string DescribeNameFault(std::string_view name, const std::string& fault);

/// Where the files that belong to images are written. Every path that an image's name is part of is made
/// here.
class ImageOutputs {
 public:
  /// \param root         nothing is written outside it; it may itself be a symbolic link.
  /// \param photos       the folder of the photos, in which nothing is written; may be empty. Where it holds
  ///                     `root`, no photo is written over.
  /// \param photo_names  of the photos, relative to their folder.
  ImageOutputs(const std::filesystem::path& root, const std::filesystem::path& photos,
               const std::vector<std::string>& photo_names);

  /// `folder / (NAME + suffix)`. Throws UserError when it would lie outside the root, by its name or through
  /// a symbolic link, or is a photo. \param folder  below the root.
  std::filesystem::path Locate(const std::filesystem::path& folder, const ImageName& name,
                               const std::string& suffix) const;
  /// The same to write there: the folders on the way are made.
  std::filesystem::path Make(const std::filesystem::path& folder, const ImageName& name,
                             const std::string& suffix) const;

 private:
  std::filesystem::path root_;             // as given
  std::filesystem::path resolved_root_;    // without symbolic links
  std::filesystem::path resolved_photos_;  // the same; empty: none, or it holds the root
  std::set<std::filesystem::path> photos_;
};

}  // namespace s2gs
