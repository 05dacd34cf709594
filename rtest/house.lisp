;;;; house.lisp: the plan of the package, read off its files: which stands on which.  For rtest_house.mac and make
;;;; house.
;;;;
;;;; A file is on the floor of its folder; a chapter is a folder of its own, and the chapters are the highest floor.
;;;; Arrows point from what uses to what is used: a function of another file that is called, handed on, or named in an
;;;; entry; a structure; a module or kernel file that anmech_need or needs asks for.
;;;;
;;;;   house_upward()       [file, file, names] of each arrow to a higher floor, or from a chapter to what another one
;;;;                        keeps for itself
;;;;   house_circles()      [file, file, ..] of each circle of files
;;;;   house_undeclared()   [file, file, names] of what is used, but not declared as needed
;;;;   house_idle()         [file, file] of each need that nothing in the file uses
;;;;   house_private()      [file, file, names] of helpers used outside of their folder that their file does not list
;;;;   house_listed()       [file, names] of names in a list of entry points that the file does not define
;;;;   house_text()         the plan in words: the floors with their files
;;;;   draw_house(name)     writes the plan to name.txt, name.dot, and by Graphviz, if it is there, to name.svg,
;;;;   name.png
;;;;
;;;; A file lists what it is for the others in its first comment: a public verb is public without that.

(in-package :anmech-tests)

(load (concatenate 'string *root* "rtest/sources.lisp"))

(defparameter *module-floors*
  '("base" "systems" "symmetry" "birkhoff" "dynamics" "inverse" "motion" "sweeps" "variations"))
(defparameter *kernel-floors*
  '("" "session" "arithmetic" "algebra" "determining" "numerics" "numerics/integrators" "sweeps"))

(defun house-list (items) (cons '(maxima::mlist maxima::simp) items))

(defun kernel-source-p (source) (kernel-file-p (source-file source)))

(defun folder-of (source)
  "The folder; of a chapter, its name."
  (let* ((name (source-name source)) (slash (position #\/ name :from-end t)))
    (cond (slash (subseq name 0 slash))
          ((kernel-source-p source) "")
          (t name))))

(defun floor-of (source)
  "The kernel's floors come below the modules'."
  (if (kernel-source-p source)
      (position (folder-of source) *kernel-floors* :test #'string=)
      (+ 100 (or (position (folder-of source) *module-floors* :test #'string=) (length *module-floors*)))))

(defun chapter-p (source) (and (not (kernel-source-p source)) (not (find #\/ (source-name source)))))

;;; Arrows

(defvar *owners* nil "From a symbol to the source that defines it.")

(defun owners ()
  (or *owners*
      (let ((table (make-hash-table :test #'eq)))
        (dolist (source (sources) (setq *owners* table))
          (dolist (name (append (source-structures source) (source-defined source)))
            (setf (gethash name table) source))))))

(defun arrows-from (source)
  "A list of (source . names)."
  (let ((arrows '()))
    (dolist (name (source-used source))
      (let ((owner (gethash name (owners))))
        (when (and owner (not (eq owner source)))
          (let ((arrow (assoc owner arrows)))
            (if arrow (push name (cdr arrow)) (push (list owner name) arrows))))))
    arrows))

(defun needs-of-source (source)
  "The sources that it declares; an unknown name is an error."
  (mapcar (lambda (name)
            (or (find name (sources) :key #'source-name :test #'string=)
                (error "~a needs ~a, which is not there" (source-name source) name)))
          (source-needs source)))

(defun all-arrows-from (source)
  "Sources only: used or declared."
  (remove-duplicates (append (mapcar #'car (arrows-from source)) (needs-of-source source))))

(defun public-p (name) (and (get name 'anmech::module) t))

(defun named-arrow (source owner &optional (names '() names-p))
  (house-list (list* (source-name source) (source-name owner)
                     (and names-p (list (house-list (sort (mapcar #'text-of names) #'string<)))))))

;;; Questions

(defun upward-arrows ()
  (loop for source in (sources)
        append (loop for owner in (all-arrows-from source)
                     for names = (cdr (assoc owner (arrows-from source)))
                     when (or (> (floor-of owner) (floor-of source))
                              (and (chapter-p source) (chapter-p owner) (notevery #'public-p names)))
                       collect (named-arrow source owner names))))

(defun circles ()
  "Each once, as the list of its files in the order of the arrows."
  (let ((found '()) (done '()))
    (labels ((visit (source path)
               (cond ((member source path)
                      (push (reverse (cons source (ldiff path (rest (member source path))))) found))
                     ((not (member source done))
                      (dolist (next (all-arrows-from source)) (visit next (cons source path)))
                      (push source done)))))
      (dolist (source (sources)) (visit source '())))
    (mapcar (lambda (path) (house-list (mapcar #'source-name path))) (nreverse found))))

(defun session-sources ()
  "What is there from the start: no module needs to ask for it."
  (let ((found '()))
    (labels ((visit (source)
               (unless (member source found)
                 (push source found)
                 (mapc #'visit (needs-of-source source)))))
      (dolist (name anmech::*session-files* found)
        (let ((source (find (concatenate 'string name ".lisp") (sources) :key #'source-name :test #'string=)))
          (when source (visit source)))))))

(defun undeclared-needs ()
  "Public verbs load their modules when they are called; what a kernel file stands on must be there before it."
  (loop for source in (sources)
        append (loop for (owner . names) in (arrows-from source)
                     for helpers = (if (kernel-source-p source) names (remove-if #'public-p names))
                     unless (or (null helpers) (member owner (needs-of-source source))
                                (and (not (kernel-source-p source)) (member owner (session-sources)))
                                (string= (folder-of owner) ""))
                       collect (named-arrow source owner helpers))))

(defun registers-p (source)
  "Whether it adds to entries that others read: then a need for it has its effect."
  (and (probe-file (source-file source)) (search "anmech_entry(" (file-text (source-file source)))))

(defun file-text (file)
  (with-open-file (stream file)
    (format nil "~{~a~%~}" (loop for line = (read-line stream nil) while line collect line))))

(defun idle-needs ()
  (loop for source in (sources)
        append (loop for owner in (needs-of-source source)
                     unless (or (assoc owner (arrows-from source))
                                (and (not (kernel-source-p owner)) (registers-p owner)))
                       collect (named-arrow source owner))))

;;; What a file lists as its own for others

(defun plain-word (text) (string-upcase (string-left-trim "$" (string-trim "." text))))

(defun words-of (text)
  (let ((words (make-hash-table :test #'equal)) (start nil))
    (loop for index from 0 to (length text)
          for char = (and (< index (length text)) (char text index))
          do (if (and char (or (alphanumericp char) (find char "_-+*%$?")))
                 (unless start (setq start index))
                 (when start
                   (setf (gethash (plain-word (subseq text start index)) words) t)
                   (setq start nil))))
    words))

(defun listed-name (name)
  "How NAME is written in a list of entry points."
  (string-upcase (string-left-trim "$" (symbol-name name))))

(defun private-uses ()
  (loop for source in (sources)
        append (loop for (owner . names) in (arrows-from source)
                     for words = (words-of (source-header owner))
                     for private = (remove-if (lambda (name)
                                                (or (public-p name) (gethash (listed-name name) words)
                                                    (accessor-of-listed-p name owner words)))
                                              names)
                     unless (or (null private) (string= (folder-of owner) (folder-of source))
                                (string= (folder-of owner) ""))
                       collect (named-arrow source owner private))))

(defun accessor-of-listed-p (name owner words)
  "Whether NAME belongs to a structure of Lisp whose name is listed: MAKE-X, X-P, X-PART."
  (and (kernel-source-p owner)
       (loop for word being the hash-keys of words
             thereis (and (> (length word) 2)
                          (or (eql 0 (search (concatenate 'string word "-") (symbol-name name)))
                              (string= (symbol-name name) (concatenate 'string "MAKE-" word)))))))

(defun listed-but-missing ()
  "Helpers that a first comment lists and no file defines."
  (let ((known (make-hash-table :test #'equal)))
    (dolist (source (sources))
      (dolist (name (append (source-defined source) (source-structures source)))
        (setf (gethash (listed-name name) known) t)))
    (loop for source in (sources)
          for missing = (loop for word being the hash-keys of (words-of (source-header source))
                              when (and (eql 0 (search "ANMECH_" word)) (not (gethash word known)))
                                collect (string-downcase word))
          when missing
            collect (house-list (list (source-name source) (house-list (sort missing #'string<)))))))

;;; The plan

(defun floors ()
  "A list of (name . sources), the highest floor first."
  (flet ((floor (name test) (cons name (sort (remove-if-not test (copy-list (sources))) #'string< :key #'source-name))))
    (append (list (floor "the book" #'chapter-p))
            (loop for name in (reverse *module-floors*)
                  collect (floor name (lambda (source) (and (not (kernel-source-p source)) (not (chapter-p source))
                                                            (string= (folder-of source) name)))))
            (loop for name in (reverse *kernel-floors*)
                  collect (floor (if (string= name "") "src" (concatenate 'string "src/" name))
                                 (lambda (source) (and (kernel-source-p source) (string= (folder-of source) name))))))))

(defun short-name (source)
  (let* ((name (source-name source)) (end (search ".lisp" name)) (slash (position #\/ name :from-end t)))
    (subseq name (if slash (1+ slash) 0) end)))

(defun plan-in-words ()
  (format nil "~{~{~26a~a~%~}~}"
          (loop for (name . sources) in (floors)
                when sources
                  collect (list name (broken-line (mapcar #'short-name sources) 26)))))

(defun broken-line (words indent)
  "WORDS with blanks between them, over lines of at most 118 characters."
  (let ((lines '()) (line ""))
    (dolist (word words)
      (when (> (+ indent (length line) 1 (length word)) 118)
        (push line lines)
        (setq line ""))
      (setq line (if (string= line "") word (concatenate 'string line " " word))))
    (format nil (format nil "~~{~~a~~^~~%~a~~}" (make-string indent :initial-element #\Space))
            (reverse (cons line lines)))))

(defun plan-as-dot ()
  "Floors as boxes, and arrows between them, without those beside which another way leads there; an arrow is as broad as
many files of the one floor use files of the other."
  (with-output-to-string (stream)
    (format stream "digraph anmech {~%  nodesep = 0.3; ranksep = 0.4;~%  node [shape = box, style = filled, ~
                    fontname = \"Helvetica\", fontsize = 11];~%  edge [color = \"#556677\", arrowsize = 0.7];~%")
    (let* ((floors (remove-if-not #'rest (floors))) (arrows (arrows-between floors)))
      (loop for (name . sources) in floors
            do (format stream "  \"~a\" [label = <<b>~a</b><br/>~{~a~^<br/>~}>, fillcolor = \"~a\"];~%" name name
                       (label-lines (mapcar #'short-name sources))
                       (if (kernel-source-p (first sources)) "#e6eef5" "#f4f1ea")))
      (loop for (from to count) in arrows
            unless (another-way-p from to arrows)
              do (format stream "  \"~a\" -> \"~a\" [penwidth = ~,1f];~%" from to
                         (+ 0.5 (* 0.5 (log count 2))))))
    (format stream "}~%")))

(defun arrows-between (floors)
  "(from to count)"
  (loop for (name . sources) in floors
        append (loop for (other . others) in floors
                     for count = (loop for source in sources
                                       sum (length (intersection others (mapcar #'car (arrows-from source)))))
                     when (and (plusp count) (not (string= name other)))
                       collect (list name other count))))

(defun another-way-p (from to arrows)
  "A way down from FROM to TO over a third floor."
  (let ((seen (list from)))
    (labels ((leads-p (here)
               (or (string= here to)
                   (unless (member here seen :test #'string=)
                     (push here seen)
                     (loop for (start end) in arrows thereis (and (string= start here) (leads-p end)))))))
      (loop for (start end) in arrows
            thereis (and (string= start from) (string/= end to) (leads-p end))))))

(defun label-lines (words)
  (loop while words
        collect (let ((line '()) (length 0))
                  (loop while (and words (or (null line) (< (+ length (length (first words))) 46)))
                        do (incf length (+ 2 (length (first words))))
                           (push (pop words) line))
                  (format nil "~{~a~^, ~}" (reverse line)))))

;;; The plan in CONTRIBUTING.md, between two lines, and its picture

(defun guide-file () (concatenate 'string *root* "CONTRIBUTING.md"))
(defun dot-file () (concatenate 'string *root* ".github/house.dot"))

(defun guide-with-plan ()
  (let* ((text (file-text (guide-file)))
         (start (+ 1 (position #\Newline text :start (search "```text house" text))))
         (end (search "```" text :start2 start)))
    (concatenate 'string (subseq text 0 start) (plan-in-words) (subseq text end))))

(defun house-is-drawn ()
  (and (string= (file-text (guide-file)) (guide-with-plan))
       (string= (file-text (dot-file)) (plan-as-dot))))

(defun draw-house ()
  (flet ((write-text (text file)
           (with-open-file (stream file :direction :output :if-exists :supersede)
             (write-string text stream))))
    (write-text (guide-with-plan) (guide-file))
    (write-text (plan-as-dot) (dot-file))))

;;; A house in which everything is wrong

(defun invented-source (name header needs structures defined used)
  (flet ((symbols (names) (mapcar (lambda (name) (intern (string-upcase name) :anmech-tests)) names)))
    (make-source :file (concatenate 'string name ".mac") :name name :header header :needs needs
                 :structures (symbols structures) :defined (symbols defined) :used (symbols used))))

(defun invented-house ()
  (list (invented-source "base/sums" "for all: anmech_sum" '() '() '("anmech_sum" "anmech_own") '("anmech_view"))
        (invented-source "systems/view" "anmech_view, anmech_gone" '("base/sums") '() '("anmech_view") '("anmech_own"))
        (invented-source "systems/kinds" "" '("systems/view") '("anmech_box") '("anmech_kind") '("anmech_box"))
        (invented-source "ch14" "" '() '() '("anmech_first") '("anmech_kind"))
        (invented-source "ch15" "" '("ch14") '() '("anmech_second") '("anmech_first" "anmech_box"))))

(defun house-answers ()
  (house-list (list (house-list (upward-arrows)) (house-list (circles)) (house-list (undeclared-needs))
                    (house-list (idle-needs)) (house-list (private-uses)) (house-list (listed-but-missing)))))

(defun wrong-house ()
  (let ((*sources* (invented-house)) (*owners* nil)) (house-answers)))

(in-package :maxima)

(defmfun $house_upward () (anmech-tests::house-list (anmech-tests::upward-arrows)))
(defmfun $house_circles () (anmech-tests::house-list (anmech-tests::circles)))
(defmfun $house_undeclared () (anmech-tests::house-list (anmech-tests::undeclared-needs)))
(defmfun $house_idle () (anmech-tests::house-list (anmech-tests::idle-needs)))
(defmfun $house_private () (anmech-tests::house-list (anmech-tests::private-uses)))
(defmfun $house_listed () (anmech-tests::house-list (anmech-tests::listed-but-missing)))
(defmfun $house_example () (anmech-tests::wrong-house))
(defmfun $house_plan () (anmech-tests::plan-in-words))
(defmfun $house_is_drawn () (anmech-tests::house-is-drawn))
(defmfun $draw_house () (anmech-tests::draw-house) '$done)
