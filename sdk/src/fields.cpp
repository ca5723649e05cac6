#include "fields.h"

namespace pathfold::core {
namespace {

using Json = nlohmann::json;

constexpr size_t max_bytes = 1 << 20;
constexpr int max_depth = 32;

/// UTF-8: C1 is 0xC2 0x80 to 0xC2 0x9F.
void refuse_controls(const std::string &text) {
    for (size_t i = 0; i < text.size(); ++i) {
        const auto byte = static_cast<unsigned char>(text[i]);
        const unsigned char next = i + 1 < text.size() ? static_cast<unsigned char>(text[i + 1]) : 0;
        if (byte < 0x20 || byte == 0x7f || (byte == 0xc2 && next >= 0x80 && next < 0xa0))
            fail(PATHFOLD_INVALID_MODEL, "manifest.json: a string holds the control character with the code ",
                 int(byte == 0xc2 ? next : byte), "; write it without");
    }
}

void refuse_controls(const Json &value) {
    if (value.is_string())
        refuse_controls(value.get_ref<const std::string &>());
    if (!value.is_structured())
        return;
    for (const auto &[key, child] : value.items()) {
        refuse_controls(key); // an array's keys are its indices
        refuse_controls(child);
    }
}

} // namespace

Json read_json(const std::string &text) {
    if (text.size() > max_bytes)
        fail(PATHFOLD_INVALID_MODEL, "manifest.json has ", text.size(), " bytes; at most ", max_bytes,
             " are read");
    const auto shallow = [](int depth, Json::parse_event_t, Json &) {
        if (depth > max_depth)
            fail(PATHFOLD_INVALID_MODEL, "manifest.json nests deeper than ", max_depth, " levels");
        return true;
    };
    try {
        Json json = Json::parse(text, shallow);
        refuse_controls(json);
        return json;
    } catch (const Json::exception &error) {
        fail(PATHFOLD_INVALID_MODEL, "manifest.json is not JSON: ", error.what());
    }
}

} // namespace pathfold::core
