#pragma once

#include <filesystem>
#include <string>

namespace s2gs {

/// The absolute path of a program that others installed.
/// \param name    as on PATH.
/// \param given   its path, or the folder that it lies in; empty: PATH is searched.
/// \param use     what is said of it after "is not on PATH"; may be empty.
/// \param remedy  how to get it.
/// Throws UserError where it is not there or cannot be executed.
std::filesystem::path FindExecutable(const std::string& name, const std::filesystem::path& given,
                                     const std::string& use, const std::string& remedy);

}  // namespace s2gs
