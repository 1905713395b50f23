// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include <dyknow/node_handle.h>
#include <nodelet/nodelet.h>
#include <std_msgs/String.h>
#include <std_srvs/Trigger.h>

#include <pluginlib/class_list_macros.hpp>
#include <string>

namespace dyknow_cpp_test
{

/// Notes its messages and the calls of its reconfigure callback, a line each.
class Listener : public nodelet::Nodelet
{
private:
  using Request = std_srvs::Trigger::Request;
  using Answer = std_srvs::Trigger::Response;

  void onInit() override
  {
    nh_ = dyknow::NodeHandle(getNodeHandle());
    in_ = nh_.subscribe("in", 10, &Listener::onMessage, this);
    second_ = nh_.subscribe("second", 10, &Listener::onMessage, this);
    nh_.setReconfigureCallback([this](const dyknow::PortTopics& inputs, const dyknow::PortTopics&)
                               { notes_ += "told " + inputs.at("in") + " " + inputs.at("second") + "\n"; });
    again_ = getPrivateNodeHandle().advertiseService("again", &Listener::onAgain, this);
    notes_service_ = getPrivateNodeHandle().advertiseService("notes", &Listener::onNotes, this);
  }

  void onMessage(const std_msgs::StringConstPtr& message) { notes_ += message->data + "\n"; }

  /// Subscribes anew.
  bool onAgain(Request&, Answer& answer)
  {
    in_.shutdown();
    in_ = nh_.subscribe("in", 10, &Listener::onMessage, this);
    return answer.success = true;
  }

  bool onNotes(Request&, Answer& answer)
  {
    answer.message = notes_;
    return answer.success = true;
  }

  dyknow::NodeHandle nh_;
  ros::Subscriber in_;
  ros::Subscriber second_;
  ros::ServiceServer again_;
  ros::ServiceServer notes_service_;
  std::string notes_;
};

}  // namespace dyknow_cpp_test

PLUGINLIB_EXPORT_CLASS(dyknow_cpp_test::Listener, nodelet::Nodelet)
