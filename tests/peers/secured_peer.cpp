// A participant with keys on Fast DDS (2.9, as Debian builds it, with DDS Security): what it sees of a stack with keys, and whether it is heard.
// By hand, not part of any test:
//
//     apt-get install libfastrtps-dev && g++ -std=c++17 -O1 tests/peers/secured_peer.cpp -o /tmp/secured_peer -lfastrtps -lfastcdr
//     bash launch_scripts/keystore.sh /tmp/keystore /patchmill /workcell
//     ROS_SECURITY_ENABLE=true ROS_SECURITY_KEYSTORE=/tmp/keystore target/security/release/patchmill up --domain 201 --surfaces tests/fixtures
//     /tmp/secured_peer 201 /tmp/keystore/enclaves/workcell 12 msgs/tests/job_cdr.hex
//
// usage: secured_peer DOMAIN ENCLAVE_FOLDER SECONDS [JOB_HEX]    JOB_HEX: a job's CDR in hexadecimal digits, published on patchmill/job; the
// stages say on stderr what they think of it. Exits with 3 when no latched status was heard.

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/domain/DomainParticipantListener.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/DataReaderListener.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>

#include <atomic>
#include <chrono>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <functional>
#include <iostream>
#include <memory>
#include <mutex>
#include <set>
#include <string>
#include <thread>
#include <vector>

using namespace eprosima::fastdds::dds;
using namespace eprosima::fastrtps::rtps;
using Bytes = std::vector<unsigned char>;

// Any type, as the bytes of its CDR with encapsulation: nothing is generated from the interfaces.
struct Raw : TopicDataType {
  explicit Raw(const char* name) {
    setName(name);
    m_typeSize = 1 << 20;
    m_isGetKeyDefined = false;
  }
  bool serialize(void* data, SerializedPayload_t* payload) override {
    const auto& bytes = *static_cast<Bytes*>(data);
    std::memcpy(payload->data, bytes.data(), bytes.size());
    payload->length = bytes.size();
    payload->encapsulation = CDR_LE;
    return true;
  }
  bool deserialize(SerializedPayload_t* payload, void* data) override {
    static_cast<Bytes*>(data)->assign(payload->data, payload->data + payload->length);
    return true;
  }
  std::function<uint32_t()> getSerializedSizeProvider(void* data) override {
    uint32_t size = static_cast<Bytes*>(data)->size();
    return [size] { return size; };
  }
  void* createData() override { return new Bytes; }
  void deleteData(void* data) override { delete static_cast<Bytes*>(data); }
  bool getKey(void*, InstanceHandle_t*, bool) override { return false; }
};

// Whom it met.
struct Met : DomainParticipantListener {
  std::mutex mutex;
  int authorized = 0, refused = 0;
  std::set<std::string> written, read;

  void onParticipantAuthentication(DomainParticipant*, ParticipantAuthenticationInfo&& info) override {
    std::lock_guard<std::mutex> lock(mutex);
    (info.status == ParticipantAuthenticationInfo::AUTHORIZED_PARTICIPANT ? authorized : refused)++;
  }
  void on_publisher_discovery(DomainParticipant*, WriterDiscoveryInfo&& info) override {
    std::lock_guard<std::mutex> lock(mutex);
    written.insert(info.info.topicName().to_string());
  }
  void on_subscriber_discovery(DomainParticipant*, ReaderDiscoveryInfo&& info) override {
    std::lock_guard<std::mutex> lock(mutex);
    read.insert(info.info.topicName().to_string());
  }
};

struct Heard : DataReaderListener {
  std::atomic<int> messages{0};
  void on_data_available(DataReader* reader) override {
    Bytes data;
    SampleInfo info;
    while (reader->take_next_sample(&data, &info) == ReturnCode_t::RETCODE_OK) messages += info.valid_data;
  }
};

static DomainParticipantQos with_keys(const std::string& enclave) {
  DomainParticipantQos qos;
  const std::string file = "file://" + enclave + "/", pki = "dds.sec.auth.builtin.PKI-DH.", access = "dds.sec.access.builtin.Access-Permissions.";
  auto& properties = qos.properties().properties();
  properties.emplace_back("dds.sec.auth.plugin", "builtin.PKI-DH");
  properties.emplace_back(pki + "identity_ca", file + "identity_ca.cert.pem");
  properties.emplace_back(pki + "identity_certificate", file + "cert.pem");
  properties.emplace_back(pki + "private_key", file + "key.pem");
  properties.emplace_back("dds.sec.crypto.plugin", "builtin.AES-GCM-GMAC");
  properties.emplace_back("dds.sec.access.plugin", "builtin.Access-Permissions");
  properties.emplace_back(access + "permissions_ca", file + "permissions_ca.cert.pem");
  properties.emplace_back(access + "governance", file + "governance.p7s");
  properties.emplace_back(access + "permissions", file + "permissions.p7s");
  // As patchmill: this machine's loopback only.
  auto udp = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
  udp->interfaceWhiteList.push_back("127.0.0.1");
  qos.transport().use_builtin_transports = false;
  qos.transport().user_transports.push_back(udp);
  return qos;
}

static Bytes from_hex(const char* path) {
  std::ifstream file(path);
  std::string digits, word;
  while (file >> word) digits += word;
  Bytes bytes;
  for (size_t i = 0; i + 1 < digits.size(); i += 2) bytes.push_back(std::stoi(digits.substr(i, 2), nullptr, 16));
  return bytes;
}

int main(int count, char** arguments) {
  if (count < 4) {
    std::cerr << "usage: secured_peer DOMAIN ENCLAVE_FOLDER SECONDS [JOB_HEX]" << std::endl;
    return 2;
  }
  Met met;
  auto* participant = DomainParticipantFactory::get_instance()->create_participant(
      std::stoi(arguments[1]), with_keys(arguments[2]), &met, StatusMask::none());
  if (!participant) {
    std::cerr << "no participant: look at the enclave's files" << std::endl;
    return 1;
  }
  struct Watched {
    const char *topic, *type;
    bool latched;
  };
  const Watched watched[] = {{"rt/diagnostics", "diagnostic_msgs::msg::dds_::DiagnosticArray_", false},
                             {"rt/patchmill/surface_ingestion/status", "patchmill_msgs::msg::dds_::StageStatus_", true},
                             {"rt/patchmill/job", "patchmill_msgs::msg::dds_::Job_", true}};
  Heard heard[3];
  auto* subscriber = participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT);
  Topic* topic = nullptr;
  for (int i = 0; i < 3; i++) {
    TypeSupport(new Raw(watched[i].type)).register_type(participant);
    topic = participant->create_topic(watched[i].topic, watched[i].type, TOPIC_QOS_DEFAULT);
    DataReaderQos qos;
    qos.reliability().kind = watched[i].latched ? RELIABLE_RELIABILITY_QOS : BEST_EFFORT_RELIABILITY_QOS;
    qos.durability().kind = watched[i].latched ? TRANSIENT_LOCAL_DURABILITY_QOS : VOLATILE_DURABILITY_QOS;
    if (!topic || !subscriber->create_datareader(topic, qos, &heard[i])) std::cerr << "no reader of " << watched[i].topic << std::endl;
  }
  if (count > 4) {
    DataWriterQos qos;
    qos.reliability().kind = RELIABLE_RELIABILITY_QOS;
    qos.durability().kind = TRANSIENT_LOCAL_DURABILITY_QOS;
    auto* writer = participant->create_publisher(PUBLISHER_QOS_DEFAULT)->create_datawriter(topic, qos);
    Bytes job = from_hex(arguments[4]);
    if (!writer || !writer->write(&job)) std::cerr << "the job was not published" << std::endl;
  }
  std::this_thread::sleep_for(std::chrono::seconds(std::stoi(arguments[3])));
  std::lock_guard<std::mutex> lock(met.mutex);
  std::cout << met.authorized << " participants authorized, " << met.refused << " refused; " << met.written.size() << " topics written, "
            << met.read.size() << " read\n";
  for (int i = 0; i < 3; i++) std::cout << watched[i].topic << ": " << heard[i].messages << " messages\n";
  std::cout.flush();
  // Without the end of Fast DDS: its threads call the listeners above until then.
  std::_Exit(heard[1].messages > 0 ? 0 : 3);
}
