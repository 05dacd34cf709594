;;; anmech: other programs that a verb makes use of, through the shell.
;;;
;;; Entry points: PROCESS-MARK, SHELL-WORD, ENDS-WELL; $anmech_succeeds, $anmech_shell_word, $anmech_maxima_command,
;;; $anmech_root_directory, $anmech_lisp_name, $anmech_objects_directory, $anmech_host_word.

(in-package :anmech)
(needs "session/patience")

(defvar *interruptions-handed-on* nil "Whether a command that is run is interrupted, too, when the session is.")

(maxima::defmfun maxima::$anmech_succeeds (command)
  "anmech_succeeds(command): runs a command of the shell, and whether it ends well."
  #+sbcl (let ((process nil))
           (unwind-protect
                (progn (setq process (sb-ext:run-program "/bin/sh" (list "-c" command)
                                                         :input nil :output t :error t :wait nil))
                       (let ((*when-noted* (and *interruptions-handed-on*
                                                (lambda () (sb-ext:process-kill process 2 :process-group)))))
                         (sb-ext:process-wait process))
                       (eql 0 (sb-ext:process-exit-code process)))
             (when (and process (sb-ext:process-alive-p process))
               (sb-ext:process-kill process 15 :process-group))))
  #+gcl (multiple-value-bind (status signal) (si:system command)
          (when (eql signal 2) (note-interruption))
          (and (eql 0 status) (eql 0 signal)))
  #+ecl (eql 0 (ext:system command))
  #-(or sbcl gcl ecl) (error "this Lisp runs no other programs: ~a" command))

(defun ends-well (command mark)
  "How a command of the shell ends that an interruption of the session ends, too: t, nil, or :interrupted, which is
noted.  MARK is the name of a file that may be made for this."
  (let ((well (let ((*interruptions-handed-on* t))
                (maxima::$anmech_succeeds (format nil "mark=~a; trap ': > \"$mark\"; exit 1' INT; ~a"
                                                  (shell-word mark) command)))))
    (cond (well t)
          ((probe-file mark) (delete-file mark) (note-interruption) :interrupted)
          ((interrupted-p) :interrupted))))

(defun shell-word (text)
  "TEXT as one word of the shell, whatever it holds."
  (with-output-to-string (out)
    (write-char #\' out)
    (loop for char across text
          do (if (char= char #\') (write-string "'\\''" out) (write-char char out)))
    (write-char #\' out)))

(maxima::defmfun maxima::$anmech_shell_word (text)
  "anmech_shell_word(text): as one word of the shell."
  (coerce (shell-word text) 'simple-string))

(maxima::defmfun maxima::$anmech_maxima_command ()
  "anmech_maxima_command(): the command that starts a Maxima like this one."
  (let ((program (format nil "~a/bin/maxima" maxima::*maxima-prefix*)))
    (format nil "~a -l ~a -u ~a" (if (probe-file program) (shell-word program) "maxima")
            maxima::*maxima-lispname* maxima::*autoconf-version*)))

(maxima::defmfun maxima::$anmech_root_directory ()
  "anmech_root_directory(): where the package lies, with a slash at its end."
  (subseq *source-directory* 0 (- (length *source-directory*) (length "src/"))))

(maxima::defmfun maxima::$anmech_objects_directory ()
  "anmech_objects_directory(): what MAXIMA_OBJDIR must be for a Maxima that is to find the kernel compiled by this one."
  (let ((directory (string-right-trim "/" (namestring maxima::$maxima_objdir))))
    ;; behind it come the versions of Maxima and Lisp, and between these the Lisp
    (loop repeat 3 do (setq directory (subseq directory 0 (position #\/ directory :from-end t))))
    (coerce directory 'simple-string)))

(maxima::defmfun maxima::$anmech_lisp_name ()
  "anmech_lisp_name(): Maxima and its Lisp, as in 5.46.0/sbcl."
  (format nil "~a/~a" maxima::*autoconf-version* maxima::*maxima-lispname*))

(defun host-name ()
  (or (machine-instance)
      (handler-case (with-open-file (stream "/proc/sys/kernel/hostname") (read-line stream))
        (error () "host"))))

(maxima::defmfun maxima::$anmech_host_word ()
  "anmech_host_word(): the letters and digits of the name of this machine."
  (coerce (remove-if-not #'alphanumericp (host-name)) 'simple-string))

(defun process-mark ()
  "HOST.PROCESS.NUMBER, which no other process has at the same time: whoever finds it can tell whether its
writer lives."
  (format nil "~a.~d.~36r" (maxima::$anmech_host_word) (process-number) (random (expt 36 8) (make-random-state t))))
