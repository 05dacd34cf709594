;;; anmech: files that must be whole or not there at all.
;;;
;;; A file is written under a passing name in its folder, read again, and renamed when it is whole: a process that is
;;; killed, or a full disk, leaves no half one, and what was there stays.  It need not fit into memory.  Of some Lisps
;;; a full disk is no error, so what can be read back tells.
;;;
;;; Entry points: WRITE-WHOLE-FILE, WRITE-FILE, TELLER-OF, PASSING-NAME, REMOVE-FILE, LINES-OF-FILE;
;;; anmech_write_text, anmech_write_lines.

(in-package :anmech)
(needs "session/file_names" "session/processes" "session/scripts" "session/texts")

(defun remove-file (file)
  (handler-case (when (probe-file file) (delete-file file))
    (error () nil)))

(defun lines-of-file (file)
  "The lines of FILE; nil if it cannot be read."
  (handler-case (with-open-file (stream file :if-does-not-exist nil)
                  (and stream (loop for line = (read-line stream nil) while line collect line)))
    (error () nil)))

(defun length-of-file (file)
  "How many characters can be read in FILE."
  (with-open-file (stream file)
    (loop with length = 0
          for (line cut) = (multiple-value-list (read-line stream nil))
          while line do (incf length (if cut (length line) (1+ (length line))))
          finally (return length))))

(defun write-and-count (passing tell-lines)
  "How many characters the lines have that TELL-LINES has told the function that it is given, which writes them to
PASSING; nil if that fails."
  (let ((length 0) (stream nil) (whole nil))
    (flet ((or-nothing (thunk) (handler-case (funcall thunk) (error () (return-from write-and-count nil)))))
      (or-nothing (lambda () (setq stream (open passing :direction :output :if-exists :supersede))))
      (unwind-protect
           (progn (funcall tell-lines (lambda (line)
                                        (incf length (1+ (length line)))
                                        (or-nothing (lambda () (write-line line stream)))))
                  (or-nothing (lambda () (finish-output stream)))
                  (setq whole t)
                  length)
        (handler-case (close stream :abort (not whole)) (error () nil))))))

(defun passing-name (file)
  "A name in the folder of FILE that no other process gives."
  (format nil "~a.part-~a" file (process-mark)))

(defun write-whole-file (file tell-lines)
  "Whether FILE now holds the lines that TELL-LINES tells the function that it is given; if not, it is as it was."
  (let ((passing (passing-name file)))
    (unwind-protect
         (let ((length (write-and-count passing tell-lines)))
           (handler-case (and length (= length (length-of-file passing)) (rename-over passing file))
             (error () nil)))
      (remove-file passing))))

(defun teller-of (lines)
  (lambda (tell) (mapc tell lines)))

(defun whole-path (file)
  "The path that FILE is a name of."
  #+sbcl (sb-ext:native-namestring (merge-pathnames file))
  #-sbcl (namestring file))

(defun rename-over (from to)
  "Whether FROM is now TO: at once, also where TO is there.  Lisps complete names of their own, so the names are whole
paths."
  #+sbcl (sb-unix:unix-rename (whole-path (truename from)) (whole-path to))
  #-sbcl (maxima::$anmech_succeeds (format nil "trap '' INT; [ ! -d ~a ] && mv -f ~a ~a" (shell-word to)
                                           (shell-word from) (shell-word to))))

;;; Files that a user names

(defun place-of-file (file)
  "The path of what is to be FILE, whose folder is there: where a link leads to, if it is one; ~ is known to Lisps
alone, not to the shell in quotes."
  (let ((there (probe-file file)) (folder (subseq file 0 (- (length file) (length (alone-of file))))))
    (if there
        (whole-path there)
        (concatenate 'string (whole-path (truename (if (string= folder "") "./" folder))) (alone-of file)))))

(defun plain-place (file)
  "The path of FILE, whose folder is made if need be; a sentence if there can be none, or it is a device or folder,
which a new file must not replace."
  (let ((place (handler-case (progn (ensure-directories-exist file) (place-of-file file))
                 (error () (complain "cannot write the file ~a: its folder cannot be made" file)))))
    (unless (maxima::$anmech_succeeds (format nil "place=~a; [ ! -e \"$place\" ] || [ -f \"$place\" ]"
                                              (shell-word place)))
      (complain "cannot write the file ~a: a folder or a device has this name" file))
    place))

(defun write-file (file tell-lines)
  "FILE holds the lines that TELL-LINES tells the function that it is given, or is as it was, and a sentence says so."
  (unless (write-whole-file (plain-place file) tell-lines)
    (complain "cannot write the file ~a: is the disk full, or its folder read-only?" file)))

(maxima::defmfun maxima::$anmech_write_text (file text)
  "anmech_write_text(file, text): FILE holds the lines of TEXT."
  (write-file file (teller-of (lines-in text)))
  'maxima::$done)

(maxima::defmfun maxima::$anmech_write_lines (file lines)
  "anmech_write_lines(file, [text, ...]): FILE holds these lines."
  (write-file file (teller-of (rest lines)))
  'maxima::$done)
