#include "onnx_check.h"

#include <cstdint>
#include <cstring>
#include <iterator>
#include <set>
#include <sstream>

#include "error.h"

namespace pathfold::core {
namespace {

/// What a network of convolutions, its feature transforms and its padding need; nothing that loops, branches,
/// reads files or draws random numbers.
constexpr const char *allowed_operators =
    "Abs Add And AveragePool BatchNormalization Cast CastLike Ceil Celu Clip Concat Constant "
    "ConstantOfShape Conv ConvInteger ConvTranspose CumSum DepthToSpace DequantizeLinear Div Dropout "
    "DynamicQuantizeLinear Einsum Elu Equal Erf Exp Expand Flatten Floor Gather Gelu Gemm "
    "GlobalAveragePool GlobalMaxPool Greater GreaterOrEqual GroupNormalization HardSigmoid HardSwish "
    "Identity InstanceNormalization IsInf IsNaN LayerNormalization LeakyRelu Less LessOrEqual Log "
    "LogSoftmax MatMul MatMulInteger Max MaxPool Mean Min Mish Mod Mul Neg Not Or PRelu Pad Pow "
    "QLinearConv QLinearMatMul QuantizeLinear Range Reciprocal ReduceL1 ReduceL2 ReduceLogSumExp "
    "ReduceMax ReduceMean ReduceMin ReduceProd ReduceSum ReduceSumSquare Relu Reshape Resize Round "
    "Selu Shape Sigmoid Sign Size Slice Softmax Softplus SpaceToDepth Split Sqrt Squeeze Sub Sum Tanh "
    "Tile Transpose Unsqueeze Where ";

bool is_allowed(const std::string &type) {
    static const std::set<std::string> names = [] {
        std::istringstream words(allowed_operators);
        return std::set<std::string>(std::istream_iterator<std::string>(words), {});
    }();
    return names.count(type) > 0;
}

/// A protobuf message walked field by field; lengths are checked against what is left.
class Message {
public:
    Message(const uint8_t *begin, const uint8_t *end, const std::string &file)
        : cursor_(begin), end_(end), file_(file) {}

    /// Steps to the next field; false at the end.
    bool next() {
        if (cursor_ == end_)
            return false;
        const uint64_t tag = varint();
        if (tag > UINT32_MAX) // protobuf would cut it to 32 bits and see another field than this walk does
            damaged();
        field_ = tag >> 3;
        switch (tag & 7) {
        case 0:
            number_ = varint();
            content_ = content_end_ = nullptr;
            break;
        case 1:
            take(8);
            break;
        case 2:
            take(varint());
            break;
        case 5:
            take(4);
            break;
        default:
            damaged();
        }
        if (field_ == 0)
            damaged();
        return true;
    }

    uint64_t field() const { return field_; }
    uint64_t number() const { return number_; }
    std::string string() const {
        if (content_ == nullptr)
            damaged();
        return {reinterpret_cast<const char *>(content_), size_t(content_end_ - content_)};
    }
    Message message() const {
        if (content_ == nullptr)
            damaged();
        return {content_, content_end_, file_};
    }
    const std::string &file() const { return file_; }

    [[noreturn]] void damaged() const {
        fail(PATHFOLD_INVALID_MODEL, file_,
             " is not a whole ONNX model: it is damaged, cut short or of "
             "another kind; export or download the model again");
    }

private:
    uint64_t varint() {
        uint64_t value = 0;
        for (int shift = 0; shift < 64; shift += 7) {
            if (cursor_ == end_)
                damaged();
            const uint8_t byte = *cursor_++;
            value |= uint64_t(byte & 0x7f) << shift;
            if (byte < 0x80)
                return value;
        }
        damaged();
    }

    void take(uint64_t size) {
        if (size > uint64_t(end_ - cursor_))
            damaged();
        content_ = cursor_;
        content_end_ = cursor_ += size;
        number_ = 0;
    }

    const uint8_t *cursor_, *end_;
    const uint8_t *content_ = nullptr, *content_end_ = nullptr;
    uint64_t field_ = 0, number_ = 0;
    const std::string &file_;
};

/// TensorProto: 13 external_data, 14 data_location (1 is external).
void check_tensor(Message tensor) {
    while (tensor.next())
        if (tensor.field() == 13 || (tensor.field() == 14 && tensor.number() != 0))
            fail(PATHFOLD_INVALID_MODEL, tensor.file(),
                 " keeps weights in another file (external data); "
                 "export it with its weights inside");
}

/// AttributeProto: 5 tensor, 10 tensors, 6 and 11 graphs, 22 and 23 sparse tensors.
void check_attribute(Message attribute, const std::string &operator_name) {
    while (attribute.next())
        switch (attribute.field()) {
        case 5:
        case 10:
            check_tensor(attribute.message());
            break;
        case 6:
        case 11:
        case 22:
        case 23:
            fail(PATHFOLD_INVALID_MODEL, attribute.file(), ": the operator ", operator_name,
                 " holds a graph or a sparse tensor, which is not allowed");
        default:
            break;
        }
}

/// NodeProto: 4 op_type, 5 attribute, 7 domain.
void check_node(Message node) {
    std::string type, domain;
    for (Message fields = node; fields.next();) {
        if (fields.field() == 4)
            type = fields.string();
        if (fields.field() == 7)
            domain = fields.string();
    }
    if ((!domain.empty() && domain != "ai.onnx") || !is_allowed(type))
        fail(PATHFOLD_INVALID_MODEL, node.file(), " uses the operator ",
             domain.empty() ? type : domain + "." + type, ", which is not on the list of allowed operators");
    for (Message fields = node; fields.next();)
        if (fields.field() == 5)
            check_attribute(fields.message(), type);
}

/// GraphProto: 1 node, 5 initializer, 15 sparse_initializer. Returns the number of nodes.
size_t check_graph(Message graph) {
    size_t nodes = 0;
    while (graph.next())
        switch (graph.field()) {
        case 1:
            check_node(graph.message());
            ++nodes;
            break;
        case 5:
            check_tensor(graph.message());
            break;
        case 15:
            fail(PATHFOLD_INVALID_MODEL, graph.file(), " holds sparse weights, which are not allowed");
        default:
            break;
        }
    return nodes;
}

} // namespace

/// ModelProto: 1 ir_version, 7 graph, 8 opset_import, 25 functions.
void check_onnx(const void *data, size_t size, const std::string &name) {
    const auto *bytes = static_cast<const uint8_t *>(data);
    Message model(bytes, bytes + size, name);
    bool opset = false;
    size_t graphs = 0, nodes = 0;
    while (model.next())
        switch (model.field()) {
        case 7:
            nodes = check_graph(model.message());
            ++graphs;
            break;
        case 8:
            opset = true;
            break;
        case 25:
            fail(PATHFOLD_INVALID_MODEL, name, " defines functions of its own, which are not allowed");
        default:
            break;
        }
    if (graphs != 1 || nodes == 0 || !opset)
        model.damaged();
}

} // namespace pathfold::core
