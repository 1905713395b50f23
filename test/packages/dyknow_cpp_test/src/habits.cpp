// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file A node with habits of public ones: it starts roscpp again and again, makes handles again with the options
/// of before (as message_filters does), looks at itself, and makes mistakes that roscpp answers.
///
/// habits N PAUSE...: N times a handle that lives for an instant; then for each pause (s) such a handle (if it is
/// not negative), the pause, and a relay that works until SIGUSR1.
#include <arpa/inet.h>
#include <netinet/tcp.h>
#include <ros/callback_queue.h>
#include <ros/poll_set.h>
#include <ros/ros.h>
#include <ros/transport/transport_tcp.h>
#include <std_msgs/Header.h>
#include <std_msgs/String.h>
#include <std_srvs/Trigger.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <vector>

namespace
{

volatile std::sig_atomic_t g_is_over = 0;

void onSignal(int)
{
  g_is_over = 1;
}

/// Is destroyed before the handles that use it, which roscpp permits once it is shut down.
class Queue : public ros::CallbackQueue
{
public:
  void end() { is_gone_ = true; }

  void removeByID(std::uint64_t id) override
  {
    if (is_gone_)
    {
      std::abort();
    }
    ros::CallbackQueue::removeByID(id);
  }

private:
  bool is_gone_ = false;
};

/// A client's end of a connection to a port of this host; its calls return once they have arrived.
class Client
{
public:
  explicit Client(int port) : socket_(socket(AF_INET, SOCK_STREAM, 0))
  {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(static_cast<std::uint16_t>(port));
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    if (connect(socket_, reinterpret_cast<sockaddr*>(&address), sizeof(address)) != 0)
    {
      std::abort();
    }
    send(socket_, "x", 1, 0);
    waitFor([](const tcp_info& info) { return info.tcpi_unacked == 0; });
  }

  ~Client() { close(socket_); }

  void end()
  {
    shutdown(socket_, SHUT_WR);
    waitFor([](const tcp_info& info) { return info.tcpi_state == TCP_FIN_WAIT2; });
  }

private:
  template <class Condition>
  void waitFor(Condition condition)
  {
    tcp_info info{};
    for (socklen_t size = sizeof(info);
         getsockopt(socket_, IPPROTO_TCP, TCP_INFO, &info, &size) == 0 && !condition(info);)
    {
      usleep(100);
    }
  }

  const int socket_;
};

/// Whether a connection is open that was accepted when another thread had closed one whose end was not handled yet,
/// and got the descriptor of that.
bool outlivesFormer()
{
  ros::PollSet sockets;
  std::vector<ros::TransportTCPPtr> accepted;
  const auto server = boost::make_shared<ros::TransportTCP>(&sockets);
  server->listen(0, 3, [&accepted](const ros::TransportTCPPtr& transport) { accepted.push_back(transport); });
  Client former(server->getServerPort());
  while (accepted.empty())
  {
    sockets.update(100);
  }
  sockets.update(0);
  // Three events at a time, in this order.
  const int first = eventfd(0, 0);
  sockets.addSocket(first, [&](int)
                    {
                      accepted[0]->close();  // as a thread does that has sent the answer
                      sockets.delSocket(first);
                    });
  sockets.update(0);
  sockets.addEvents(first, POLLOUT);
  Client newcomer(server->getServerPort());
  former.end();
  while (accepted.size() < 2)
  {
    sockets.update(100);
  }
  std::uint8_t byte;
  const bool is_open = accepted[1]->read(&byte, 1) == 1;
  for (const auto& each : {accepted[0], accepted[1], server})
  {
    each->close();
  }
  close(first);
  return is_open;
}

class Relay
{
public:
  explicit Relay(Queue& queue)
    : nh_(handle("", queue))
    , private_nh_(handle("~", queue))
    , publication_(ros::AdvertiseOptions::create<std_msgs::String>("out", 10, {}, {}, {}, nullptr))
    , subscription_(ros::SubscribeOptions::create<std_msgs::String>(
          "in", 10, [this](const std_msgs::StringConstPtr& message) { out_.publish(message); }, {}, nullptr))
    , out_(nh_.advertise(publication_))
    , in_(nh_.subscribe(subscription_))
    , again_(private_nh_.advertiseService("again", &Relay::onAgain, this))
    , retyped_(private_nh_.advertiseService("retyped", &Relay::onRetyped, this))
    , taken_(private_nh_.advertiseService("taken", &Relay::onTaken, this))
    , seen_(private_nh_.advertiseService("seen", &Relay::onSeen, this))
    , refused_(private_nh_.advertiseService("refused", &Relay::onRefused, this))
    , accepted_(private_nh_.advertiseService("accepted", &Relay::onAccepted, this))
  {
  }

  /// Publishes as a callback does that is overtaken by a shutdown; returns whether it had a topic for that.
  bool publishLast() const
  {
    ros::NodeHandle nh(nh_);
    const ros::Publisher last = nh.advertise<std_msgs::String>("last", 1);
    last.publish(std_msgs::String());
    return static_cast<bool>(last);
  }

private:
  using Request = std_srvs::Trigger::Request;
  using Answer = std_srvs::Trigger::Response;

  static ros::NodeHandle handle(const std::string& space, Queue& queue)
  {
    ros::NodeHandle nh(space);
    nh.setCallbackQueue(&queue);
    return nh;
  }

  bool onAgain(Request&, Answer& answer)
  {
    in_.shutdown();
    in_ = nh_.subscribe(subscription_);
    out_.shutdown();
    out_ = nh_.advertise(publication_);
    answer.success = true;
    return true;
  }

  /// Advertises its topic with another type.
  bool onRetyped(Request&, Answer& answer)
  {
    in_.shutdown();
    out_.shutdown();
    out_ = nh_.advertise<std_msgs::Header>("out", 10);
    answer.success = true;
    return true;
  }

  /// Offers services of its own that have names of DyKnow's.
  bool onTaken(Request&, Answer& answer)
  {
    answer.success = true;
    for (const char* name : {"poll", "get_config"})
    {
      own_.push_back(private_nh_.advertiseService(name, &Relay::onOwn, this));
      answer.success = answer.success && own_.back();
    }
    return true;
  }

  bool onOwn(Request&, Answer& answer)
  {
    answer.message = "its own";
    return answer.success = true;
  }

  /// Reports the node's own view of its topics.
  bool onSeen(Request&, Answer& answer)
  {
    ros::V_string advertised;
    ros::V_string subscribed;
    ros::this_node::getAdvertisedTopics(advertised);
    ros::this_node::getSubscribedTopics(subscribed);
    for (auto* topics : {&advertised, &subscribed})
    {
      std::sort(topics->begin(), topics->end());
      for (const auto& each : *topics)
      {
        answer.message += each + " ";
      }
    }
    ros::Publisher gone = nh_.advertise<std_msgs::String>("gone", 1);
    const ros::Publisher copy = gone;
    gone.shutdown();
    answer.message += out_.getTopic() + " " + in_.getTopic() + " " + copy.getTopic();
    answer.success = true;
    ROS_INFO("seen");
    return true;
  }

  /// Reports the exceptions that roscpp throws.
  bool onRefused(Request&, Answer& answer)
  {
    for (const char* type : {"", "*", "std_msgs/String"})
    {
      for (const char* md5sum : {"", "*", ros::message_traits::md5sum<std_msgs::String>()})
      {
        ros::SubscribeOptions subscription;
        subscription.topic = "refused";
        subscription.datatype = type;
        subscription.md5sum = md5sum;
        answer.message += refusal([&] { nh_.subscribe(subscription); });
        ros::AdvertiseOptions publication("refused", 1, md5sum, type, "string data\n");
        answer.message += refusal([&] { nh_.advertise(publication); });
      }
    }
    subscription_.topic = "not a name";
    answer.message += refusal([&] { nh_.subscribe(subscription_); });
    answer.success = true;
    return true;
  }

  bool onAccepted(Request&, Answer& answer)
  {
    answer.success = outlivesFormer();
    return true;
  }

  template <class Call>
  std::string refusal(Call call)
  {
    try
    {
      call();
    }
    catch (const ros::Exception& error)
    {
      return std::string(error.what()) + "\n";
    }
    return "taken\n";
  }

  ros::NodeHandle nh_;
  ros::NodeHandle private_nh_;
  ros::AdvertiseOptions publication_;
  ros::SubscribeOptions subscription_;
  ros::Publisher out_;
  ros::Subscriber in_;
  ros::ServiceServer again_;
  ros::ServiceServer retyped_;
  ros::ServiceServer taken_;
  ros::ServiceServer seen_;
  ros::ServiceServer refused_;
  ros::ServiceServer accepted_;
  std::vector<ros::ServiceServer> own_;
};

/// A parameter by way of a handle of its own: where it is the only one, roscpp is started and shut down.
void readParameter()
{
  ros::NodeHandle("~").param("unset", 0);
}

}  // namespace

int main(int argc, char** argv)
{
  std::signal(SIGUSR1, &onSignal);
  ros::init(argc, argv, "habits");
  if (argc == 2 && std::strcmp(argv[1], "start") == 0)
  {
    ros::start();
    return 0;
  }
  for (int i = 0; argc > 1 && i < std::atoi(argv[1]); ++i)
  {
    readParameter();
    ros::WallDuration(0.001 * (i % 20)).sleep();
  }
  for (int i = 2; i < argc; ++i)
  {
    if (const double pause = std::atof(argv[i]); pause >= 0)
    {
      readParameter();
      ros::WallDuration(pause).sleep();
    }
    Queue queue;
    const Relay relay(queue);
    g_is_over = 0;
    std::printf("relay %d\n", i - 1);
    std::fflush(stdout);
    while (g_is_over == 0)
    {
      if (!ros::ok())
      {
        std::printf("published at the end: %d\n", relay.publishLast());
        queue.end();
        return 0;
      }
      queue.callAvailable(ros::WallDuration(0.01));
    }
  }
  return 0;
}
