// A peer that is Fast DDS 2: fastdds DOMAIN ACTION TYPE TOPIC QOS, as cyclone.py has them. Its types are declared here, so
// that no code generator is needed.

#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <iostream>
#include <map>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <fastcdr/Cdr.h>
#include <fastcdr/FastBuffer.h>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <fastrtps/utils/IPLocator.h>

using namespace eprosima::fastdds::dds;
using eprosima::fastcdr::Cdr;
using eprosima::fastcdr::FastBuffer;
using eprosima::fastrtps::rtps::SerializedPayload_t;

struct Header {
    int32_t sec = 5;
    uint32_t nanosec = 7;
    std::string frame_id = "from fast dds";
    template <class Visit> void fields(Visit visit) { visit(sec), visit(nanosec), visit(frame_id); }
};

struct Twist {
    static constexpr const char* name = "geometry_msgs::msg::dds_::Twist_";
    double x = 0.25, y = 0, z = 0, roll = 0, pitch = 0, yaw = -0.5;
    template <class Visit> void fields(Visit visit) {
        for (double* value : {&x, &y, &z, &roll, &pitch, &yaw}) visit(*value);
    }
};

struct TwistStamped {
    static constexpr const char* name = "geometry_msgs::msg::dds_::TwistStamped_";
    Header header;
    Twist twist;
    template <class Visit> void fields(Visit visit) { header.fields(visit), twist.fields(visit); }
};

struct LaserScan {
    static constexpr const char* name = "sensor_msgs::msg::dds_::LaserScan_";
    Header header;
    float angle_min = -3, angle_max = 3, increment = 0.5, time_increment = 0, scan_time = 0.1, range_min = 0.15,
          range_max = 12;
    std::vector<float> ranges{1.5, 1.75, 2.25}, intensities;
    template <class Visit> void fields(Visit visit) {
        header.fields(visit);
        for (float* value : {&angle_min, &angle_max, &increment, &time_increment, &scan_time, &range_min, &range_max})
            visit(*value);
        visit(ranges), visit(intensities);
    }
};

struct OccupancyGrid {
    static constexpr const char* name = "nav_msgs::msg::dds_::OccupancyGrid_";
    Header header;
    int32_t sec = 1;
    uint32_t nanosec = 2;
    float resolution = 0.5;
    uint32_t width = 2, height = 1;
    std::vector<double> origin{0, 0, 0, 0, 0, 0, 1};
    std::vector<int8_t> data{-1, 100};
    template <class Visit> void fields(Visit visit) {
        header.fields(visit), visit(sec), visit(nanosec), visit(resolution), visit(width), visit(height);
        for (double& value : origin) visit(value);
        visit(data);
    }
};

template <class T> class Support : public TopicDataType {
public:
    Support() {
        setName(T::name);
        m_typeSize = 1 << 20;
    }
    bool serialize(void* sample, SerializedPayload_t* payload) override {
        FastBuffer buffer(reinterpret_cast<char*>(payload->data), payload->max_size);
        Cdr cdr(buffer, Cdr::DEFAULT_ENDIAN, Cdr::DDS_CDR);
        payload->encapsulation = cdr.endianness() == Cdr::BIG_ENDIANNESS ? CDR_BE : CDR_LE;
        cdr.serialize_encapsulation();
        static_cast<T*>(sample)->fields([&](auto& field) { cdr << field; });
        payload->length = static_cast<uint32_t>(cdr.getSerializedDataLength());
        return true;
    }
    bool deserialize(SerializedPayload_t* payload, void* sample) override {
        FastBuffer buffer(reinterpret_cast<char*>(payload->data), payload->length);
        Cdr cdr(buffer, Cdr::DEFAULT_ENDIAN, Cdr::DDS_CDR);
        cdr.read_encapsulation();
        static_cast<T*>(sample)->fields([&](auto& field) { cdr >> field; });
        return true;
    }
    std::function<uint32_t()> getSerializedSizeProvider(void*) override {
        return [this] { return m_typeSize; };
    }
    void* createData() override { return new T(); }
    void deleteData(void* sample) override { delete static_cast<T*>(sample); }
    bool getKey(void*, InstanceHandle_t*, bool) override { return false; }
};

struct Print {
    template <class T> void operator()(const std::vector<T>& values) const {
        for (T value : values) std::cout << +value << ' ';
    }
    template <class T> void operator()(const T& value) const { std::cout << value << ' '; }
};

template <class Target> void set(Target& target, const std::string& qos) {
    target.reliability().kind = qos == "sensors" ? BEST_EFFORT_RELIABILITY_QOS : RELIABLE_RELIABILITY_QOS;
    target.durability().kind = qos == "latched" ? TRANSIENT_LOCAL_DURABILITY_QOS : VOLATILE_DURABILITY_QOS;
    target.history().kind = KEEP_LAST_HISTORY_QOS;
    target.history().depth = qos == "sensors" ? 5 : qos == "commands" ? 10 : 1;
}

template <class T> void run(DomainParticipant* participant, std::string action, std::string name, std::string qos) {
    TypeSupport(new Support<T>()).register_type(participant);
    Topic* topic = participant->create_topic(name, T::name, TOPIC_QOS_DEFAULT);
    std::cout << "ready" << std::endl;
    if (action == "print") {
        DataReaderQos reader_qos = DATAREADER_QOS_DEFAULT;
        set(reader_qos, qos);
        auto subscriber = participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT);
        auto reader = subscriber->create_datareader(topic, reader_qos);
        for (T sample;; sample = T()) {
            SampleInfo info;
            reader->wait_for_unread_message({3600, 0});
            while (reader->take_next_sample(&sample, &info) == ReturnCode_t::RETCODE_OK) {
                if (!info.valid_data) continue;
                sample.fields(Print());
                std::cout << std::endl;
            }
        }
    }
    DataWriterQos writer_qos = DATAWRITER_QOS_DEFAULT;
    set(writer_qos, qos);
    auto publisher = participant->create_publisher(PUBLISHER_QOS_DEFAULT);
    auto writer = publisher->create_datawriter(topic, writer_qos);
    for (T sample;;) {
        writer->write(&sample);
        std::this_thread::sleep_for(std::chrono::milliseconds(action == "latch" ? 3600'000 : 20));
    }
}

int main(int count, char** args) {
    if (count != 6) return 1;
    std::string action = args[2], type = args[3], topic = args[4], qos = args[5];
    DomainParticipantQos participant_qos = PARTICIPANT_QOS_DEFAULT;
    auto transport = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
    transport->interfaceWhiteList = {"127.0.0.1"};
    participant_qos.transport().use_builtin_transports = false;
    participant_qos.transport().user_transports.push_back(transport);
    eprosima::fastrtps::rtps::Locator_t peer;
    eprosima::fastrtps::rtps::IPLocator::setIPv4(peer, "127.0.0.1");
    participant_qos.wire_protocol().builtin.initialPeersList.push_back(peer);
    auto participant = DomainParticipantFactory::get_instance()->create_participant(std::atoi(args[1]), participant_qos);
    if (!participant) return 1;
    if (type == "Twist") run<Twist>(participant, action, topic, qos);
    if (type == "TwistStamped") run<TwistStamped>(participant, action, topic, qos);
    if (type == "LaserScan") run<LaserScan>(participant, action, topic, qos);
    if (type == "OccupancyGrid") run<OccupancyGrid>(participant, action, topic, qos);
    return 1;
}
