#pragma once

#include <cstdint>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>

#include "error.h"

namespace pathfold::core {

/// A JSON value with the path that leads to it, so that every complaint names its key.
class Field {
public:
    Field(const nlohmann::json &value, std::string path) : value_(value), path_(std::move(path)) {}

    template <typename... Parts>
    [[noreturn]] void wrong(const Parts &...must) const {
        std::string given = value_.dump();
        if (given.size() > 60)
            given = given.substr(0, 60) + "...";
        fail(PATHFOLD_INVALID_MODEL, "manifest.json: ", path_, " is ", given, "; it must be ", must...);
    }

    /// The object's keys must be among `known`.
    const Field &keys(const std::set<std::string> &known) const {
        if (!value_.is_object())
            wrong("an object with the keys ", list(known));
        for (const auto &[key, unused] : value_.items())
            if (known.count(key) == 0)
                fail(PATHFOLD_INVALID_MODEL, "manifest.json: unknown key ", child(key),
                     "; known keys there: ", list(known));
        return *this;
    }

    bool has(const char *key) const { return value_.is_object() && value_.contains(key); }

    Field at(const std::string &key) const {
        if (!value_.is_object())
            wrong("an object");
        const auto found = value_.find(key);
        if (found == value_.end())
            fail(PATHFOLD_INVALID_MODEL, "manifest.json: ", child(key), " is missing");
        return {*found, child(key)};
    }

    std::vector<std::pair<std::string, Field>> members() const {
        if (!value_.is_object() || value_.empty())
            wrong("an object that is not empty");
        std::vector<std::pair<std::string, Field>> fields;
        for (const auto &[key, value] : value_.items())
            fields.emplace_back(key, Field(value, child(key)));
        return fields;
    }

    std::vector<Field> items() const {
        if (!value_.is_array())
            wrong("an array");
        std::vector<Field> fields;
        for (size_t i = 0; i < value_.size(); ++i)
            fields.emplace_back(value_[i], text(path_, "[", i, "]"));
        return fields;
    }

    std::string string() const {
        if (!value_.is_string())
            wrong("a string");
        return value_.get<std::string>();
    }

    bool boolean() const {
        if (!value_.is_boolean())
            wrong("true or false");
        return value_.get<bool>();
    }

    int64_t integer(int64_t least, int64_t most) const {
        // JSON has one kind of number: 8.0 is an integer.
        const double value = value_.is_number() ? value_.get<double>() : 0.5;
        if (value != std::floor(value) || value < double(least) || value > double(most))
            wrong("an integer from ", least, " to ", most);
        return int64_t(value);
    }

    double number(double least, double most) const {
        if (!value_.is_number() || !(value_.get<double>() >= least) || !(value_.get<double>() <= most))
            wrong("a number from ", least, " to ", most);
        return value_.get<double>();
    }

    std::string one_of(const std::set<std::string> &choices) const {
        const std::string given = string();
        if (choices.count(given) == 0)
            wrong("one of ", list(choices));
        return given;
    }

    bool is_string() const { return value_.is_string(); }

private:
    std::string child(const std::string &key) const { return path_.empty() ? key : path_ + "." + key; }

    const nlohmann::json &value_;
    std::string path_;
};

/// The text as JSON. Throws invalid-model where it is none, too large, nested too deep, or where a string in
/// it holds a control character: text from elsewhere ends up on terminals, so none of it may steer one.
nlohmann::json read_json(const std::string &text);

} // namespace pathfold::core
