#pragma once

#include <sstream>
#include <stdexcept>
#include <string>

#include "pathfold/pathfold.h"

namespace pathfold::core {

/// What every part throws; api.cpp turns it into a status and a message.
class Error : public std::runtime_error {
public:
    Error(pathfold_status status, const std::string &message)
        : std::runtime_error(message), status_(status) {}
    pathfold_status status() const { return status_; }

private:
    pathfold_status status_;
};

/// Puts its arguments together as text.
template <typename... Parts>
std::string text(const Parts &...parts) {
    std::ostringstream stream;
    (stream << ... << parts);
    return stream.str();
}

/// Throws an Error whose message is the parts put together.
template <typename... Parts>
[[noreturn]] void fail(pathfold_status status, const Parts &...parts) {
    throw Error(status, text(parts...));
}

/// "a, b, c" of a range of strings, or "none".
template <typename Range>
std::string list(const Range &range) {
    std::string joined;
    for (const auto &item : range)
        joined += (joined.empty() ? "" : ", ") + std::string(item);
    return joined.empty() ? "none" : joined;
}

} // namespace pathfold::core
